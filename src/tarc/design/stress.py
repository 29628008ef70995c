"""Limits of a finished design: payload, encoder bits, control rate, computation delay and speed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.certificates.base import Certificate
from tarc.core import validation as check
from tarc.core.array_ops import HUGE
from tarc.core.errors import InvalidParameter
from tarc.core.progress import Progress
from tarc.design.noise import torque_noise
from tarc.design.result import Design
from tarc.design.stress_case import MAX_ERROR_RATIO, StressCase, StressRun
from tarc.design.writer import DURATION
from tarc.signals.sensors import Encoder

QUESTIONS = {"payload": "kg", "bits": "bits", "rate": "Hz", "computation_delay": "periods", "speed": "rad/s"}
"""Quantities whose limit can be found, with units."""
MAX_CERTIFICATES = 10
"""Largest number of certificates per question."""
MAX_RUNS = 3
"""Largest number of simulations per question."""
TOLERANCE = 0.03
"""Relative tolerance of a limit, where `MAX_CERTIFICATES` are enough for it."""
MAX_BITS = 52
"""Most bits of an encoder."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StressLimit:
    """The limit of one quantity, the others unchanged.

    Attributes
    ----------
    name
        The quantity, one of `QUESTIONS`.
    value
        The last certified value; None where the question does not apply, and ``note`` says why.
    verdict
        The verdict there; for bits, the predicted torque noise.
    beyond, beyond_verdict
        The nearest tried value that is not certified, and its verdict; None where every tried value is certified.
    run
        The simulation at the value; None without simulations.
    beyond_runs
        Simulations just beyond the value and at about twice the distance. The certificate is sufficient and not
        necessary, so that they may complete.
    note
        A remark.
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
        """Return the limit with its verdicts and simulations, on one line."""
        if self.value is None:
            return f"{self.name}: no answer; {self.note}"
        parts = [f"{self.name}: {self.value:.4g} {self.unit}, {self.verdict}"]
        if self.run is not None:
            parts.append(f"simulated: {self.run}")
            if not self.run.stable:
                parts.append("NOT CONFIRMED: this contradicts the verdict, do not trust it")
        parts.append(
            "every tried value is certified" if self.beyond is None else f"{self.beyond:.4g}: {self.beyond_verdict}"
        )
        parts += [f"simulated at {run.value:.4g}: {run}" for run in self.beyond_runs]
        return "; ".join([*parts, self.note] if self.note else parts)


def try_design(design: Design, duration: float = DURATION) -> StressRun:
    """Simulate a design as it is, along the motion of its own scenario, with the torque limits lifted.

    Parameters
    ----------
    design
        The design.
    duration
        Of the simulation [s].

    Returns
    -------
    StressRun
        Error, torque noise, and the share of the torques beyond their limits, to compare with what was predicted.
    """
    return StressCase.from_design(design).simulate(np.nan, duration)


def predict_design_error(design: Design, duration: float = DURATION) -> float:
    """Return the RMS error [rad or m] that the linear loop predicts for `try_design`.

    The error is that of the linearised law on the robot's model along the motion, and of the encoders' noise. Torque
    limits and the first second are left out. See `tarc.design.prediction.predict_error`.

    Parameters
    ----------
    design
        The design.
    duration
        Of the motion [s].
    """
    return StressCase.from_design(design).predict(duration)


def stress_test(
    design: Design,
    *,
    questions: Sequence[str] = tuple(QUESTIONS),
    noise_budget: float = 0.05,
    simulate: bool = True,
    duration: float = 4.0,
    progress: bool | None = None,
) -> dict[str, StressLimit]:
    """Find how far one quantity may change, with the gains unchanged, until a design is no longer certified.

    ``payload`` is the largest one, with the smallest as designed. ``rate`` is the lowest control rate; the window is
    as near as whole periods allow. ``computation_delay`` counts periods beyond the delay that the law is designed for.
    ``speed`` is the largest speed of any joint; the other speeds and the accelerations change in proportion.

    Each is increased by doubling steps until the certificate fails, then bisected. Values between the tried ones are
    not certified. ``bits`` is the smallest number of bits with which the predicted torque noise stays within its
    budget; the certificate does not depend on the encoder.

    Parameters
    ----------
    design
        As `tarc.design.design_controller` returns it.
    questions
        Which of ``payload``, ``bits``, ``rate``, ``computation_delay`` and ``speed`` to answer.
    noise_budget
        For bits: RMS torque noise allowed over the torque limit of each joint. The design's own noise is always
        allowed.
    simulate
        Simulate at the limit, just beyond it and at about twice the distance.
    duration
        Duration of each simulation [s].
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    dict
        The limit of each question. Where the simulation at a limit is unstable, its ``confirmed`` is False.

    Raises
    ------
    InvalidParameter
        For unknown questions, numbers out of range, and what is no design.
    """
    if not isinstance(design, Design):
        raise InvalidParameter(f"design: got {type(design).__name__}; needs what tarc.design.design_controller returns")
    names = [questions] if isinstance(questions, str) else list(questions)
    for name in names:
        check.one_of("questions", name, QUESTIONS)
    check.number("noise_budget", noise_budget, 0, strict=True)
    check.number("duration", duration, 1.0)
    base = StressCase.from_design(design)
    usual_error = base.simulate(np.nan, duration).rms_error if simulate else np.nan
    limits = {}
    steps = MAX_CERTIFICATES + MAX_RUNS
    with Progress("stress test", len(names) * steps, progress) as bar:
        for number, name in enumerate(names, 1):
            limit = _bits_limit(base, noise_budget) if name == "bits" else _SEARCHES[name](base, bar.advance)
            if simulate and limit.value is not None:
                max_error = np.inf if name == "speed" else MAX_ERROR_RATIO * usual_error
                limit = _with_runs(base, limit, duration, max_error, bar.advance)
            limits[name] = limit
            bar.advance(number * steps - bar.done)
    return limits


def _with_runs(
    base: StressCase, limit: StressLimit, duration: float, max_error: float, done: Callable[[], object]
) -> StressLimit:
    """Add the simulations at a limit, just beyond it and at about twice the distance."""
    values = [limit.value or 0.0]
    if limit.beyond is not None:
        far = {"rate": limit.beyond / 2, "bits": max(limit.beyond - 1, 1)}
        values += [limit.beyond, far.get(limit.name, 2 * limit.beyond)]
    runs = []
    for value in values:
        runs.append(base.change(limit.name, value).simulate(value, duration, max_error))
        done()
    return replace(limit, run=runs[0], beyond_runs=tuple(runs[1:]))


def _search(
    base: StressCase, name: str, start: float, step: float, done: Callable[[], object], *, is_whole: bool = False
) -> StressLimit:
    """Return the last certified value: from a certified one by steps that double, then by bisection.

    Whole numbers are increased one by one. For a rate the period is stepped.
    """
    certified, refused = start, None
    verdicts = {start: _verdict(base.design.certificates["robot"])}
    for _ in range(MAX_CERTIFICATES):
        if refused is not None and (is_whole or refused - certified <= TOLERANCE * refused):
            break
        trial = certified + step if refused is None else (certified + refused) / 2
        certificate = base.change(name, 1 / trial if name == "rate" else trial).certificate()
        verdicts[trial] = _verdict(certificate)
        if certificate.certified:
            certified, step = trial, step if is_whole else 2 * step
        else:
            refused = trial
        done()
    value, beyond = (1 / trial if trial and name == "rate" else trial for trial in (certified, refused))
    last = "" if refused is None else verdicts[refused]
    return StressLimit(name=name, value=value, verdict=verdicts[certified], beyond=beyond, beyond_verdict=last)


def _verdict(certificate: Certificate) -> str:
    margin = f" with a margin of {100 * certificate.margin:.2g} %" if certificate.certified else ""
    return f"{certificate.verdict}{margin}"


def _payload_limit(base: StressCase, done: Callable[[], object]) -> StressLimit:
    """Search from the designed payload; the first step is a tenth of the load that doubles the inertia at home."""
    first = base.design.plants[0]
    if "payload" not in first.parameters:
        return StressLimit(name="payload", note=f"{type(first).__name__} has no such parameter")
    own = float(np.squeeze(first.parameters["payload"]))
    M = first.inertia(first.home)
    per_mass = np.trace(first.with_parameters({"payload": own + 1.0}).inertia(first.home) - M)
    start = own if base.payload is None else base.payload
    limit = _search(base, "payload", start, float(0.1 * np.trace(M) / max(per_mass, 1e-3)), done)
    loaded = first.with_parameters({"payload": limit.value})
    gravity = np.array([loaded.gravity_torque(posture) for posture in base.design.workspace.sample(200)], dtype=float)
    share = float(np.max(np.abs(gravity) / base.law.torque_limits))
    return replace(limit, note=f"gravity takes up to {share:.0%} of a torque limit" if share > 1 else "")


def _speed_limit(base: StressCase, done: Callable[[], object]) -> StressLimit:
    """Search from the designed speed upwards."""
    speed = base.workspace.speed
    if speed is None or not speed.any():
        return StressLimit(name="speed", note="the design is certified for any speed, or for a robot at rest")
    start = float(speed.max())
    return _search(base, "speed", start, start / 4, done)


def _rate_limit(base: StressCase, done: Callable[[], object]) -> StressLimit:
    """Search from the designed period upwards."""
    period = base.design.law.period
    return _search(base, "rate", period, period / 4, done)


def _delay_limit(base: StressCase, done: Callable[[], object]) -> StressLimit:
    """Add one period after the other."""
    return _search(base, "computation_delay", 0, 1, done, is_whole=True)


_SEARCHES: dict[str, Callable[[StressCase, Callable[[], object]], StressLimit]] = {
    "payload": _payload_limit,
    "speed": _speed_limit,
    "rate": _rate_limit,
    "computation_delay": _delay_limit,
}


def _bits_limit(base: StressCase, noise_budget: float) -> StressLimit:
    """Return the fewest bits with which the predicted torque noise is within the budget."""
    limits = base.law.torque_limits
    if not np.any(limits < HUGE):
        note = "without a torque limit there is no budget of torque noise; design with torque_limits"
        return StressLimit(name="bits", note=note)

    def noise_ratio(sensor: Encoder) -> float:
        predicted = torque_noise(base.design.candidate.noise, base.design.shape, sensor)
        return float(np.max(predicted / limits))

    ratios = {bits: noise_ratio(base.change("bits", bits).sensor) for bits in range(1, MAX_BITS + 1)}
    allowed = max(noise_budget, noise_ratio(base.sensor))
    value = min((bits for bits, ratio in ratios.items() if ratio <= allowed * (1 + 1e-9)), default=MAX_BITS)
    verdicts = {bits: f"predicted torque noise {ratio:.2%} of a limit" for bits, ratio in ratios.items()}
    if value == 1:
        return StressLimit(name="bits", value=1, verdict=verdicts[1])
    return StressLimit(
        name="bits", value=value, verdict=verdicts[value], beyond=value - 1, beyond_verdict=verdicts[value - 1]
    )
