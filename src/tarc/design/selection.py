"""From a robot and an encoder to certified gains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate
from tarc.certificates.robot import certify_robot
from tarc.certification import certify_law
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.progress import Progress
from tarc.core.validation import Numbers
from tarc.design.adaptation import Adaptation, choose_adaptation, expected_step
from tarc.design.candidates import WINDOWS, Candidate, assess_candidates, enumerate_candidates, pareto_front
from tarc.design.robot_facts import assumptions, gravity_load, velocity_limits
from tarc.design.robustness import RobustnessSpec
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.signals.sensors import Encoder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tarc.scenario.model import Scenario


DEFAULT_NOISE_BUDGET = 0.01
"""RMS of the torque that measurement noise makes, as a share of the torque limit, where nothing else is asked for."""
MAX_BUDGET_FACTOR = 2.0
"""How much more noise is taken than that share, or than the quietest certified loop makes where it is above it, if that
makes the error less by more than the square of it."""
MAX_REFINEMENTS = 5
"""Most times that the neighbours of the best loop are looked at closely."""
SLOPE_RATIO = 1.0
"""Slope of TARC's robust term at its cap over the stiffness K1: it costs up to a quarter of the spread borne."""
MIN_SPREAD_MARGIN = 0.1
"""By which share the spread that the loop bears must exceed the robot's."""


@dataclass(frozen=True)
class Choice:
    """One of the things that a design settles: what, its value, and why."""

    name: str
    value: str
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """A controller with the reasons for it and its certificates.

    Attributes
    ----------
    law
        The law, ready for `tarc.simulate` and the real-time face.
    plants
        The robot with its least and its greatest payload.
    workspace
        The postures it is certified for.
    sensor
        The encoder.
    certificates
        As `tarc.certify_law` gives them; that of the robot is certified.
    choices
        What was chosen and why, in order.
    shape, spread
        X [kg m²], scaled so that the eigenvalues of M(q)⁻¹X lie between 1 and the spread.
    candidates
        All loops that were looked at; those on the Pareto front are its ``front``.
    chosen
        The one chosen.
    torque_noise
        Predicted RMS of the torque that measurement noise makes, shape (n,) [N m].
    payload
        Least and greatest payload [kg].
    budget
        Torque noise allowed, as a share of the torque limit; None where a natural frequency was given and no budget.
    """

    law: TDC | TARC
    plants: tuple[Plant, ...]
    workspace: Workspace
    sensor: Encoder
    certificates: dict[str, Certificate]
    choices: tuple[Choice, ...]
    shape: np.ndarray
    spread: float
    candidates: tuple[Candidate, ...]
    candidate: Candidate
    torque_noise: np.ndarray
    payload: tuple[float, float] = (0.0, 0.0)
    noise_budget: float | None = None

    @property
    def front(self) -> list[Candidate]:
        """Loops that bear the spread and that no other beats in both torque noise and error, by noise."""
        return pareto_front(self.candidates)

    def explain(self) -> str:
        """Every choice with its reason, then the verdict."""
        lines = [f"{one.name}: {one.value}\n    {one.reason}" for one in self.choices]
        return "\n".join([*lines, "", self.certificates["robot"].explain()])

    def scenario(self, duration: float = 10.0) -> "Scenario":
        """A scenario for `tarc run`: slow sines about the middle of the workspace, the greatest payload from half-time.

        It needs a robot from a file or one of the package's own.
        """
        from tarc.design.writer import scenario_of

        return scenario_of(self, duration)

    def to_yaml(self) -> str:
        """The scenario as YAML, each choice with its reason beside the key that it concerns, the verdict on top."""
        from tarc.design.writer import to_commented_yaml

        return to_commented_yaml(self)

    def save(self, path: str | Path = "design.yaml", figures: bool = True) -> list[Path]:
        """Write what `to_yaml` gives, the certificates as JSON beside it, and figures; the files written.

        Parameters
        ----------
        path
            Of the YAML file; the other files have its name as the beginning of theirs.
        figures
            Draw `plot`'s figures and that of the law with its certificates.
        """
        from tarc.design.writer import save
        from tarc.plotting.design import design_figures

        return save(self, path, design_figures(self) if figures else None)

    def plot(self, kind: str = "front") -> "Figure":
        """``front``: torque noise against error of all loops, with the choice; ``reach``: the spread that windows and
        natural frequencies bear.
        """
        from tarc.plotting.design import FIGURES

        return FIGURES[check.one_of("kind", kind, FIGURES)](self)


def design_controller(
    plant: Plant,
    *,
    period: float = 1e-3,
    sensor: Encoder | None = None,
    payload: tuple[float, float] = (0.0, 0.0),
    workspace: Workspace | None = None,
    speed: Numbers | None = None,
    acceleration: Numbers | None = None,
    natural_frequency: float | None = None,
    damping_ratio: float = 1.0,
    noise_budget: float | None = None,
    torque_limits: Numbers | None = None,
    law: str = "TARC",
    diagonal: bool = False,
    computation_delay: int = 0,
    samples: int = 500,
    seed: int = 0,
    progress: bool | None = None,
) -> Design:
    """Choose M̂, window, degree, natural frequency, delay, synchronisation and adaptation for a robot, and certify them.

    The shape of M̂ spreads the eigenvalues of M(q)⁻¹M̂ least over workspace and payload. Of the loops that bear
    this spread, with room, the one that rejects disturbances best within a budget of torque noise is taken; without a
    budget, at a given natural frequency, the one with the least noise.

    Parameters
    ----------
    plant
        The robot. Rotor inertia counts: without it light links make the spread so large that nothing bears it.
    period
        Control period [s].
    sensor
        The encoder; None for 17 bits.
    payload
        Least and greatest payload at the tool [kg].
    workspace
        Postures to certify for; None for all that the joints reach.
    speed
        Greatest speed of the joints [rad/s or m/s], one number or one a joint; infinite for any. None for that of the
        workspace, or without one for the velocity limits in the robot's file, where all joints have one. The slower
        the robot, the better the gains that are certified.
    acceleration
        Greatest acceleration of the joints [rad/s² or m/s²], likewise; None for that of the workspace, or that which
        reaches the speed in a quarter of a second.
    natural_frequency
        ωn [rad/s]; None to have it chosen.
    damping_ratio
        ζ.
    noise
        Budget: RMS of the torque that measurement noise makes, as a share of the torque limit of each joint; None for
        one per cent, or as little as can be certified, or as a given natural frequency allows.
    torque_limit
        [N m or N], one number or one a joint; None for the robot's own.
    law
        ``TARC`` or ``TDC``.
    diagonal
        Of all diagonal M̂ only.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Postures to sample.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    Design
        Certified.

    Raises
    ------
    TarcError
        When nothing can be certified: which requirement to relax, and by how much. For conflicting or missing
        requirements.
    """
    check.one_of("law", law, ("TARC", "TDC"))
    sensor = Encoder(bits=17) if sensor is None else sensor
    low, high = (check.number("payload", one, 0) for one in payload)
    if high < low:
        raise TarcError(f"payload: got {low:g} to {high:g} kg; needs the least one first")
    check.number("damping_ratio", damping_ratio, 0, strict=True)
    share = SLOPE_RATIO if law == "TARC" else 0.0
    plants = _with_payloads(plant, low, high)
    workspace = (
        Workspace.from_joint_limits(plant).with_speed_limits(velocity_limits(plant)) if workspace is None else workspace
    )
    if speed is not None or acceleration is not None:
        workspace = workspace.with_speed_limits(workspace.speed if speed is None else speed, acceleration)
    limits = _limits(plant, torque_limits)
    sigma = _deviation(sensor, plant.n_joints)
    _check_budget(plant.joint_names, natural_frequency, noise_budget, limits, sigma)
    if natural_frequency is not None:
        natural_frequency = check.number("natural_frequency", natural_frequency, 0, strict=True)
    held = gravity_load(plants, workspace, limits, seed)
    trials = enumerate_candidates(
        period,
        natural_frequencies=None if natural_frequency is None else [natural_frequency],
        damping_ratio=damping_ratio,
        computation_delay=check.integer("computation_delay", computation_delay),
        windows=WINDOWS if natural_frequency is None else range(2, 31),
    )
    trials = [one for one in trials if one.synchronised or one.degree == 2]  # literal ones of 3 are beaten by others
    with Progress("designing", len(trials) + 60, progress) as bar:
        shape, _ = best_inertia_shape(plants, workspace, samples=samples, diagonal=diagonal, tolerance=0.03, seed=seed)
        found = inertia_spread(plants, shape, workspace, samples=samples, seed=seed)
        shape, ratio = shape / found.min_ratio, found.ratio  # so that the eigenvalues of M(q)⁻¹X are 1 and above
        demand = RobustnessSpec.from_robot(plants, workspace, shape, found, seed=seed)
        bar.advance(20)
        looked = assess_candidates(trials, demand, slope_ratio=share, min_margin=MIN_SPREAD_MARGIN, done=bar.advance)
        need = _Need(plants, workspace, shape, demand, sigma, limits, natural_frequency, noise_budget, looked)
        best = need.pick()
        seen: set[Candidate] = set()
        for _ in range(MAX_REFINEMENTS):
            near = [one for one in _near(best, natural_frequency is None) if one not in seen]
            seen.update(near)
            looked = [
                *looked,
                *assess_candidates(near, demand, slope_ratio=share, min_margin=MIN_SPREAD_MARGIN, exhaustive=True),
            ]
            before, best = best, replace(need, looked=looked).pick()
            if best == before:
                break
        bar.advance(20)
        made, adapted = _law(law, best, shape, plants, workspace, sensor, limits)
        verdict = certify_robot(
            made, plants, workspace, computation_delay=computation_delay, samples=samples, seed=seed
        )
        for more in (0.03, 0.06, 0.12, 0.25):  # what local searches found beyond the postures above
            if verdict.certified:
                break
            near = _near(best, natural_frequency is None)
            roomier = assess_candidates(
                near, demand, slope_ratio=share, min_margin=MIN_SPREAD_MARGIN + more, exhaustive=True
            )
            roomier += [one for one in looked if one.spread_margin >= MIN_SPREAD_MARGIN + more]
            if not any(one.feasible for one in roomier):
                break
            best = replace(need, looked=roomier).pick()
            made, adapted = _law(law, best, shape, plants, workspace, sensor, limits)
            verdict = certify_robot(
                made, plants, workspace, computation_delay=computation_delay, samples=samples, seed=seed
            )
        if not verdict.certified:
            raise TarcError(
                f"design: the loop that bears the spread on paper is {verdict.verdict} on the robot, margin "
                f"{verdict.margin:.3g}; use more samples, or a smaller workspace"
            )
        certificates = certify_law(
            made, plants, workspace, computation_delay=computation_delay, samples=samples, seed=seed, known=verdict
        )
        bar.advance(20)
    predicted = best.noise * np.linalg.norm(shape * sigma, axis=1)
    result = Design(
        law=made,
        plants=tuple(plants),
        workspace=workspace,
        sensor=sensor,
        certificates=certificates,
        choices=(),
        shape=shape,
        spread=ratio,
        candidates=tuple(looked),
        candidate=best,
        torque_noise=predicted,
        payload=(low, high),
        noise_budget=None if natural_frequency is not None and noise_budget is None else need.budget,
    )
    given = [Choice(*one) for one in assumptions(plants, workspace, limits, held, own=torque_limits is None)]
    return replace(result, choices=(*given, *_choices(result, found, adapted, limits, need)))


def _with_payloads(plant: Plant, low: float, high: float) -> list[Plant]:
    if not high:
        return [plant]
    if "payload" not in plant.parameters:
        raise TarcError(f"payload: {plant!r} has no such parameter; leave it out, or use a robot from a file")
    ends = [low] if low == high else [low, high]
    return [plant.with_parameters({"payload": mass}) for mass in ends]


def _limits(plant: Plant, given: Numbers | None) -> np.ndarray:
    """Torque limits, infinite where there is none; a limit of zero in a file stands for none."""
    if given is not None:
        return check.vector("torque_limit", given, plant.n_joints, 0, strict=True)
    own = plant.torque_limits
    return np.where(own > 0, own, np.inf)


def _deviation(sensor: Encoder, joints: int) -> np.ndarray:
    """Standard deviation of the measurement [rad or m], shape (n,): that of rounding is a step over √12."""
    return np.broadcast_to(np.sqrt(sensor.noise**2 + sensor.step_size**2 / 12), (joints,))


def _check_budget(
    names: Sequence[str], natural_frequency: float | None, noise: float | None, limits: np.ndarray, sigma: np.ndarray
) -> None:
    if noise is not None:
        check.number("noise", noise, 0, strict=True)
    limited = np.isfinite(limits)
    if natural_frequency is None and not limited.all():
        missing = ", ".join(name for name, known in zip(names, limited, strict=True) if not known)
        raise TarcError(
            f"torque_limit: none is known for joint {missing}, so that there is no budget for torque noise; give "
            "torque_limit, or a natural frequency, at which the least noise is taken"
        )
    if noise is not None and not limited.any():
        raise TarcError("noise: it is a share of the torque limit, and none is known; give torque_limit too")
    if natural_frequency is None and not np.any(sigma):
        raise TarcError(
            "sensor: with a perfect one torque noise sets no limit to the natural frequency; give bits, a "
            "resolution or noise, "
            "or a bandwidth"
        )


def _near(best: Candidate, free: bool) -> list[Candidate]:
    """The neighbours of a candidate, closer than the grid."""
    speeds = (
        [float(f"{one * best.natural_frequency:.3g}") for one in (0.85, 1.0, 1.18)]
        if free
        else [best.natural_frequency]
    )
    windows = {w for w in (best.window - 1, best.window, best.window + 1) if w >= best.degree}
    return enumerate_candidates(
        best.period,
        natural_frequencies=speeds,
        windows=sorted(windows),
        degrees=[best.degree],
        delays=[best.delay],
        synchronised=[best.synchronised],
        damping_ratio=best.damping_ratio,
        computation_delay=best.computation_delay,
    )


@dataclass(frozen=True)
class _Need:
    """What is asked for, against what the loops can do."""

    plants: Sequence[Plant]
    workspace: Workspace
    shape: np.ndarray
    demand: RobustnessSpec
    sigma: np.ndarray
    limits: np.ndarray
    natural_frequency: float | None
    noise: float | None
    looked: Sequence[Candidate]

    @property
    def budget(self) -> float:
        """Torque noise allowed, as a share of the limit."""
        return DEFAULT_NOISE_BUDGET if self.noise is None else self.noise

    @property
    def free(self) -> float:
        """Torque noise that is taken without a second thought: the budget, or the least there is if none is given."""
        if self.noise is not None:
            return self.noise
        return max(self.budget, self.level(pareto_front(self.looked)[0]))

    def level(self, one: Candidate) -> float:
        """Torque noise over the limit, of the joint where it is greatest."""
        return float(np.max(one.noise * np.linalg.norm(self.shape * self.sigma, axis=1) / self.limits))

    def pick(self) -> Candidate:
        """The choice; `TarcError` says what to relax where there is none."""
        able = pareto_front(self.looked)
        if not able:
            raise TarcError(self._out_of_reach())
        if self.natural_frequency is not None:
            best = able[0]
            if self.noise is not None and self.level(best) > self.noise:
                raise TarcError(
                    f"natural_frequency, noise: at {self.natural_frequency:g} rad/s the least torque noise is "
                    f"{100 * self.level(best):.3g} % of the limit and {100 * self.noise:.3g} % was asked for; lower "
                    f"the natural frequency, allow {self.level(best):.3g}, or take {self._bits(best):.0f} more bits"
                )
            return best
        least, free = able[0], self.free
        allowed = free if self.noise is not None else MAX_BUDGET_FACTOR * free
        quiet = [one for one in able if self.level(one) <= allowed]
        if quiet:
            return min(quiet, key=lambda one: max(self.level(one), free) ** 2 * one.error)
        raise TarcError(
            f"noise: {100 * self.budget:.3g} % of the torque limit is allowed, and the least that a certified loop "
            f"makes is {100 * self.level(least):.3g} %; allow noise={self.level(least):.2g}, or take an encoder with "
            f"{self._bits(least):.0f} more bits"
        )

    def _bits(self, one: Candidate) -> float:
        return float(np.ceil(np.log2(self.level(one) / self.budget)))

    def _out_of_reach(self) -> str:
        from tarc.design.relaxations import remedies

        widest = max(self.looked, key=lambda one: one.max_spread, default=None)
        reach = 1.0 if widest is None else widest.max_spread
        asked = "" if self.natural_frequency is None else f" at {self.natural_frequency:g} rad/s"
        enough = reach >= (1 + MIN_SPREAD_MARGIN) * self.demand.spread
        gravity = "; those that bear this are not stiff enough for gravity and motion" if enough else ""
        advice = remedies(
            self.plants, self.workspace, self.shape, self.demand, self.looked, self.natural_frequency, MIN_SPREAD_MARGIN
        )
        return (
            f"design: nothing can be certified{asked}: the eigenvalues of M(q)⁻¹M̂ spread by {self.demand.spread:.3g}, "
            f"and the loops bear at most {reach:.3g} (of which "
            f"{100 * MIN_SPREAD_MARGIN:.0f} % is kept as room){gravity}. {advice}"
        )


def _law(
    kind: str,
    best: Candidate,
    shape: np.ndarray,
    plants: Sequence[Plant],
    workspace: Workspace,
    sensor: Encoder,
    limits: np.ndarray,
) -> tuple[TDC | TARC, tuple[Adaptation, float] | None]:
    common = {**best.law_options(), "inertia": best.inertia_scale * shape, "estimator": best.estimator}
    if np.isfinite(limits).any():
        common["torque_limit"] = limits
    if kind == "TDC":
        return TDC(**common), None
    expected = expected_step(plants, workspace)
    noise = float(np.linalg.norm(_deviation(sensor, len(shape))))
    adapted = choose_adaptation(best, expected, noise=noise)
    return TARC(**{**common, **adapted.law_options()}), (adapted, expected)


def _choices(
    made: Design, found: Any, adapted: tuple[Adaptation, float] | None, limits: np.ndarray, need: _Need
) -> list[Choice]:
    best, T = made.candidate, made.candidate.period
    diagonal = np.count_nonzero(made.shape - np.diag(np.diag(made.shape))) == 0
    level = need.level(best)
    share = f"{100 * level:.2g} % of its limit" if np.isfinite(limits).any() else "no limit is known"
    loudest = int(np.argmax(made.torque_noise / limits if np.isfinite(limits).all() else made.torque_noise))
    name = made.plants[0].joint_names[loudest]
    above, scarce = level > need.budget, need.free > need.budget
    least = (
        "the least noise of all that do" if need.natural_frequency is not None else "the least error within the budget"
    )
    if above and need.natural_frequency is None:
        least = f"the least error times noise squared within {MAX_BUDGET_FACTOR:g} times the "
        least += "noise of the quietest" if scarce else "budget"
    result = [
        Choice(
            "inertia",
            f"{best.inertia_scale:.4g} times the shape, a {'diagonal' if diagonal else 'full'} matrix",
            f"of all {'diagonal ' if diagonal else ''}M̂ this shape spreads the eigenvalues of M(q)⁻¹M̂ least: by "
            f"{made.spread:.3g} over {'the payloads and ' if len(made.plants) > 1 else ''}the workspace "
            f"({found.samples} samples and local search); scaled they lie between {best.inertia_scale:.3g} and "
            f"{best.inertia_scale * made.spread:.3g}, which the loop bears with "
            f"at least {100 * best.spread_margin:.0f} % to spare",
        ),
        Choice(
            "window",
            f"{1e3 * best.window * T:g} ms, {best.window} periods, degree {best.degree}",
            f"a shorter one bears more spread and makes more torque noise; of {len(need.looked)} loops looked at "
            f"{sum(one.feasible for one in need.looked)} bear it, and this one has {least}",
        ),
        Choice(
            "natural_frequency",
            f"{best.natural_frequency:.4g} rad/s, damping {best.damping_ratio:g}",
            "as asked for"
            if need.natural_frequency is not None
            else "no loop that bears the spread, gravity and motion makes as little torque noise as "
            f"{100 * need.budget:.3g} % of the limit"
            if scarce
            else f"more torque noise than {100 * need.budget:.3g} % of the limit pays here: the error falls by more "
            "than the square of it"
            if above
            else f"the highest that pays within torque noise of {100 * need.budget:.3g} % of the limit",
        ),
        Choice(
            "synchronised",
            "yes" if best.synchronised else "no",
            "the averaged torque of the past pairs with the averaged acceleration, so that a far larger M̂ is stable"
            if best.synchronised
            else "at this window the literal law bears the spread and makes less torque noise",
        ),
        Choice(
            "delay",
            "that of the window" if best.synchronised else f"{1e3 * best.delay * T:g} ms",
            "the torque is averaged over the window"
            if best.synchronised
            else "the shortest that the rate allows"
            if best.delay == 1
            else "with the delay of the actuation one period would leave an alternating torque undamped",
        ),
        Choice(
            "torque noise",
            f"{made.torque_noise[loudest]:.3g} N m RMS at {name}, {share}",
            "white noise of the encoder's resolution through the loop that runs; the greatest over the spread",
        ),
    ]
    if adapted is not None:
        values, expected = adapted
        result += [
            Choice(
                "boundary, cap",
                f"{values.boundary_layer:.3g} rad, {values.max_gain:.3g} rad/s²",
                f"a step of {expected:.3g} rad/s², the largest of payload or friction, leaves this error without the "
                f"switching term; the cap keeps its slope at {best.robust_slope:.4g} 1/s², which is certified",
            ),
            Choice(
                "rise, fall",
                f"{values.rise_rate:.3g}, {values.fall_rate:.3g} 1/s³",
                "an error as wide as the layer moves the gain between floor and cap within the time of the "
                "natural frequency; "
                "with no more rise than fall it would stay low, and with far more at its cap",
            ),
            Choice("min_gain", f"{values.min_gain:.3g} rad/s²", "a hundredth of the cap: above zero, and no more"),
        ]
    return result
