"""What a finished design stands: the heaviest payload, the coarsest encoder, the slowest rate, the longest delay."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate
from tarc.certificates.robot import certify_robot
from tarc.core import validation as check
from tarc.core.array_ops import HUGE
from tarc.core.errors import DesignWarning, InvalidParameter
from tarc.core.progress import Progress
from tarc.design.noise import torque_noise
from tarc.design.result import Design
from tarc.design.writer import slow_sines
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.signals.disturbances import Payload
from tarc.signals.references import Sinusoid
from tarc.signals.sensors import Encoder
from tarc.simulation.simulator import simulate

QUESTIONS = {"payload": "kg", "bits": "bits", "rate": "Hz", "computation_delay": "periods", "speed": "rad/s"}
"""What may be asked, with units."""
MAX_CERTIFICATES = 10
"""Most certificates a question."""
TOLERANCE = 0.01
"""A limit is found to this share of it, if the tries suffice."""
MAX_ERROR_RATIO = 10.0
"""An RMS error so many times that of the design itself counts as unstable: nonlinear loops swing and do not diverge."""
SMOOTHING_PERIODS = 51
"""Periods of torque that a parabola is fitted to; what it leaves counts as noise."""


@dataclass(frozen=True, eq=False)
class StressRun:
    """What a simulation made of a value.

    Torque limits are lifted, as the certificate assumes: with them an unstable loop need not diverge, but swings.

    Attributes
    ----------
    value
        In the question's unit.
    stable
        Whether it ran to the end, with an RMS error at most ten times that of the design itself; for a faster motion,
        whether it ran to the end.
    status
        In words.
    rms_error
        Over all joints [rad or m], its first quarter, at most a second, left out; NaN where it did not complete.
    torque_noise
        RMS of the torque but for its slow part, a parabola over 51 periods, shape (n,) [N m or N]; NaN as above.
    excess
        Share of the samples, over all joints, in which the torque was beyond its limit.
    """

    value: float
    stable: bool
    status: str
    rms_error: float
    torque_noise: np.ndarray
    saturation_share: float

    def __str__(self) -> str:
        if np.isnan(self.rms_error):
            return self.status
        swings = "" if self.stable else f" but at over {MAX_ERROR_RATIO:g} times the error of the design itself"
        beyond = f", {self.saturation_share:.2%} of torques beyond their limit" if self.saturation_share else ""
        noise = f"noise up to {self.torque_noise.max():.3g}"
        return f"{self.status}{swings}, RMS error {self.rms_error:.3g}, {noise}{beyond}"


@dataclass(frozen=True, kw_only=True, eq=False)
class StressLimit:
    """The answer to one question.

    Attributes
    ----------
    name
        The question.
    value
        The last one tried that passes; None where the question does not apply, and ``note`` says why.
    verdict
        The certificate there; for bits, the torque noise predicted.
    beyond, beyond_verdict
        The nearest value tried that does not pass, and its verdict; None where every value tried passes.
    run
        The simulation at the value; None without.
    beyond_runs
        Simulations just beyond it and about twice as far. The certificate is only sufficient: they may well complete.
    note
        What else is to be known.
    """

    name: str
    value: float | None = None
    verdict: str = ""
    beyond: float | None = None
    beyond_verdict: str = ""
    run: StressRun | None = None
    beyond_runs: tuple[StressRun, ...] = ()
    note: str = ""

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return QUESTIONS[self.name]

    @property
    def confirmed(self) -> bool | None:
        """Whether the simulation at the value is stable; None without one."""
        return None if self.run is None else self.run.stable

    def explain(self) -> str:
        """The answer with its reasons, in one line."""
        if self.value is None:
            return f"{self.name}: no answer; {self.note}"
        parts = [f"{self.name}: {self.value:.4g} {self.unit}, {self.verdict}"]
        if self.run is not None:
            parts.append(f"simulated: {self.run}")
            if not self.run.stable:
                parts.append("NOT CONFIRMED: this contradicts the verdict, do not trust it")
        parts.append("nothing tried fails" if self.beyond is None else f"{self.beyond:.4g}: {self.beyond_verdict}")
        parts += [f"simulated at {one.value:.4g}: {one}" for one in self.beyond_runs]
        return "; ".join([*parts, self.note] if self.note else parts)


def stress_test(
    design: Design,
    *,
    questions: Sequence[str] = tuple(QUESTIONS),
    noise_budget: float = 0.05,
    simulate: bool = True,
    duration: float = 4.0,
    progress: bool | None = None,
) -> dict[str, StressLimit]:
    """How far one thing may change before a design, its gains unchanged, is no longer certified.

    ``payload``: the heaviest load, with the least one as designed. ``rate``: the slowest, with gains, M̂ and adaptation
    the same and the window as near as whole periods allow. ``computation_delay``: by how many periods the torque may
    come later than the law was told. ``speed``: the fastest motion, as the greatest speed of any joint, those of the
    others, and the accelerations, in proportion; simulated with sines as quick as that allows. Each by steps until the
    certificate
    fails and bisection between, with at most ten certificates; what lies between the values tried was not looked at.
    ``bits``: the fewest over the encoder's span with which the torque noise, predicted as in
    `tarc.design.design_controller`,
    stays within a share of the torque limit, for the certificate does not depend on the encoder.

    Parameters
    ----------
    design
        From `tarc.design.design_controller`.
    questions
        Which of ``payload``, ``bits``, ``rate``, ``computation_delay`` and ``speed`` to answer.
    noise
        For bits: RMS torque noise allowed, as a share of each joint's limit; the design's own where that is more.
    simulate
        Run the limit, what lies just beyond it and what lies about twice as far.
    duration
        Of each simulation [s].
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    dict
        By question. A simulation that fails at a limit raises nothing: ``confirmed`` is then False.

    Raises
    ------
    TarcError
        For unknown questions, numbers out of range, and what is no design.
    """
    if not isinstance(design, Design):
        raise InvalidParameter(f"design: got {type(design).__name__}; needs what tarc.design.design_controller returns")
    asked = [questions] if isinstance(questions, str) else list(questions)
    for name in asked:
        check.one_of("questions", name, QUESTIONS)
    check.number("noise_budget", noise_budget, 0, strict=True)
    check.number("duration", duration, 1.0)
    mass = float(np.squeeze(design.plants[-1].parameters["payload"])) if len(design.plants) > 1 else None
    base = _Case(design, design.law, design.sensor, design.law.actuation_delay, mass, design.workspace)
    found, usual = {}, base.simulate(np.nan, duration).rms_error if simulate else np.nan
    with Progress("limits", len(asked) * (MAX_CERTIFICATES + 3), progress) as bar:
        for number, name in enumerate(asked, 1):
            if name == "payload":
                limit = _payload(base, bar)
            elif name == "bits":
                limit = _bits(base, noise_budget)
            elif name == "speed":
                limit = _speed(base, bar)
            else:
                start, step = (0, 1) if name == "computation_delay" else (design.law.period, design.law.period / 4)
                limit = _search(base, bar, name, start, step)
            if simulate and limit.value is not None:
                runs, most = [], np.inf if name == "speed" else usual  # a faster motion has more error of itself
                for value in (limit.value, *_farther(limit)):
                    runs.append(_changed(base, name, value).simulate(value, duration, most))
                    bar.advance()
                limit = replace(limit, run=runs[0], beyond_runs=tuple(runs[1:]))
            found[name] = limit
            bar.advance(number * (MAX_CERTIFICATES + 3) - bar.done)
    return found


@dataclass(frozen=True)
class _Case:
    """A design with one thing changed: its law, encoder, periods of delay, heaviest payload [kg], or motion."""

    design: Design
    law: TDC | TARC
    sensor: Encoder
    delay: int
    mass: float | None
    workspace: Workspace
    fast: bool = False

    def certificate(self) -> Certificate:
        plants = [self.design.plants[0]]
        if self.mass is not None:
            plants.append(plants[0].with_parameters({"payload": self.mass}))
        samples = self.design.certificates["robot"].evidence.samples
        return certify_robot(self.law, plants, self.workspace, computation_delay=self.delay, samples=samples)

    def simulate(self, value: float, duration: float, usual: float = np.inf) -> StressRun:
        """The motion of `Design.scenario`, or the workspace's own reference; the payload comes at half-time.

        The usual error is that of the design itself.
        """
        reference = self.design.workspace.reference
        if reference is None:
            reference = slow_sines(self.design.law, self.design.plants, self.design.workspace)
            if self.fast:
                frequency = speed_factor(reference, self.workspace) * np.asarray(reference.frequency)
                reference = replace(reference, frequency=frequency)
        else:
            duration = min(duration, float(self.design.workspace.high[0]))
        free = replace(self.law, torque_limit=np.inf)
        longer = int(np.ceil(self.law.period / self.design.law.period - 1e-9))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DesignWarning)  # beyond the limit it is no news
            made = simulate(
                self.design.plants[0],
                free,
                reference,
                duration,
                sensor=self.sensor,
                initial_torque="rest",
                disturbance=() if self.mass is None else Payload(mass=self.mass, start_time=duration / 2),
                computation_delay=self.delay,
                substeps=None if longer == 1 else 2 * longer,
                progress=False,
            )
        torque = made.data["torque"].values
        error, noise = np.nan, np.full(torque.shape[1], np.nan)
        if made.status.completed:
            error, noise = made.metrics(min(1.0, duration / 4))["rms_error"], _rough(torque)
        excess = float(np.mean(np.abs(torque) > self.law.torque_limits))
        return StressRun(value, bool(error <= MAX_ERROR_RATIO * usual), str(made.status), error, noise, excess)


def speed_factor(sines: Sinusoid, workspace: Workspace) -> float:
    """Return the factor on the frequencies at which a joint reaches its largest speed or acceleration."""
    if workspace.speed is None or workspace.acceleration is None:
        return 1.0
    speed = np.abs(np.asarray(sines.amplitude) * np.asarray(sines.frequency))
    acceleration = speed * np.asarray(sines.frequency)
    moves = speed > 0
    if not moves.any():
        return 1.0
    by_acceleration = np.sqrt(workspace.acceleration[moves] / acceleration[moves])
    return float(min(np.min(workspace.speed[moves] / speed[moves]), np.min(by_acceleration)))


def _rough(torque: np.ndarray) -> np.ndarray:
    """RMS of what a moving parabola leaves of the torques (k, n), shape (n,)."""
    from scipy.signal import savgol_filter

    odd = min(SMOOTHING_PERIODS, len(torque) - 1 + len(torque) % 2)
    return np.sqrt(np.mean((torque - savgol_filter(torque, odd, 2, axis=0)) ** 2, axis=0))


def _changed(base: _Case, name: str, value: float) -> _Case:
    """The case with this value, in the question's unit."""
    if name == "payload":
        return replace(base, mass=value)
    if name == "bits":
        return replace(base, sensor=replace(base.sensor, bits=int(value), resolution=None))
    if name == "speed" and base.workspace.speed is not None:
        return replace(base, workspace=base.workspace.scale_speed(value / base.workspace.speed.max()), fast=True)
    if name == "computation_delay":
        return replace(base, delay=base.delay + int(value))
    law, estimator, period = base.design.law, base.design.estimator, 1 / value
    shrink = law.period / period
    computation_delay = int(np.ceil(law.actuation_delay * shrink - 1e-9))
    window = max(estimator.degree, round(estimator.window / law.period * shrink))
    # a delay of one period would leave an alternating torque undamped where the computation delay is odd
    delay = None if law.delay_periods == 1 else (1 + computation_delay % 2) * period
    slower = replace(
        base.law,
        period=period,
        estimator=Algebraic(window=window * period, degree=estimator.degree),
        delay=delay,
        actuation_delay=computation_delay,
    )
    return replace(base, law=slower, delay=computation_delay)


def _farther(limit: StressLimit) -> tuple[float, ...]:
    """Just beyond the limit, and about twice as far."""
    if limit.beyond is None:
        return ()
    far = {"rate": limit.beyond / 2, "bits": max(limit.beyond - 1, 1)}
    return limit.beyond, far.get(limit.name, 2 * limit.beyond)


def _search(base: _Case, bar: Progress, name: str, start: float, step: float) -> StressLimit:
    """The last value certified, from one that is: in steps that double, then by bisection; delays period by period.

    Of a rate it is the period that is stepped.
    """
    whole = name == "computation_delay"
    good, bad = start, None
    said = {start: _said(base.design.certificates["robot"])}
    for _ in range(MAX_CERTIFICATES):
        if bad is not None and (whole or bad - good <= TOLERANCE * bad):
            break
        trial = good + step if bad is None else (good + bad) / 2
        found = _changed(base, name, 1 / trial if name == "rate" else trial).certificate()
        said[trial] = _said(found)
        if found.certified:
            good, step = trial, step if whole else 2 * step
        else:
            bad = trial
        bar.advance()
    value, beyond = (1 / one if one and name == "rate" else one for one in (good, bad))
    last = "" if bad is None else said[bad]
    return StressLimit(name=name, value=value, verdict=said[good], beyond=beyond, beyond_verdict=last)


def _said(found: Certificate) -> str:
    return f"{found.verdict}, {100 * found.margin:.2g} % to spare" if found.certified else found.verdict


def _payload(base: _Case, bar: Progress) -> StressLimit:
    """The first step is a tenth of the load that doubles the inertia at home."""
    first = base.design.plants[0]
    if "payload" not in first.parameters:
        return StressLimit(name="payload", note=f"{type(first).__name__} has no such parameter")
    own = float(np.squeeze(first.parameters["payload"]))
    M = first.inertia(first.home)
    more = np.trace(first.with_parameters({"payload": own + 1.0}).inertia(first.home) - M)
    start = own if base.mass is None else base.mass
    found = _search(base, bar, "payload", start, float(0.1 * np.trace(M) / max(more, 1e-3)))
    heavy = first.with_parameters({"payload": found.value})
    held = np.array([heavy.gravity_torque(posture) for posture in base.design.workspace.sample(200)], dtype=float)
    share = float(np.max(np.abs(held) / base.law.torque_limits))
    return replace(found, note=f"to hold it takes up to {share:.0%} of a torque limit" if share > 1 else "")


def _speed(base: _Case, bar: Progress) -> StressLimit:
    """From the speed designed for upwards."""
    speed = base.workspace.speed
    if speed is None or not speed.any():
        return StressLimit(name="speed", note="it is certified for any speed, or for a robot at rest")
    start = float(speed.max())
    return _search(base, bar, "speed", start, start / 4)


def _bits(base: _Case, noise: float) -> StressLimit:
    """Fewest bits with the predicted torque noise, as `tarc.design.design_controller` predicts it, within the share."""
    if not np.any(base.law.torque_limits < HUGE):
        return StressLimit(
            name="bits", note="torque noise has no torque limit to be held against; design with torque_limit"
        )

    def share(sensor: Encoder) -> float:
        predicted = torque_noise(base.design.candidate.noise, base.design.shape, sensor)
        return float(np.max(predicted / base.law.torque_limits))

    shares = {bits: share(_changed(base, "bits", bits).sensor) for bits in range(1, 53)}
    allowed = max(noise, share(base.sensor))
    value = min((bits for bits, one in shares.items() if one <= allowed * (1 + 1e-9)), default=52)
    said = {bits: f"predicted torque noise {one:.2%} of a limit" for bits, one in shares.items()}
    if value == 1:
        return StressLimit(name="bits", value=1, verdict=said[1])
    return StressLimit(name="bits", value=value, verdict=said[value], beyond=value - 1, beyond_verdict=said[value - 1])
