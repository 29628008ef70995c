"""Designs by `tarc.design.design_controller` for six arms: ``python -m benchmarks.design``, or ``make bench-design``.

For each arm of example-robot-data it measures a certified design at 1 kHz with 17-bit encoders, and its time. It runs
the design with the largest payload and compares predicted and measured torque noise. It compares the design with hand
picks.

A hand pick is the literal law with the inertia and window that a sweep of simulated runs found best for that motion.
Some sweeps also vary the natural frequency. A sweep keeps within the torque variation and the processor time of the
design. It has the design's switching gain, and may do without.

The design is certified on the whole workspace, and the sweep sees one motion. So each hand pick is certified over the
workspace as well, and run where its loop is worst. Designs with M̂(q) of the file, without and with the rest of the
model, run on the same motion. A second design is certified for a tube about the motion, within the
torque variation of the first.

The sweeps are limited by time, so their numbers vary from run to run.
"""

import argparse
import csv
import os
import sysconfig
import time
import warnings
from bisect import bisect_right
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import tarc
from tarc.analysis import Workspace
from tarc.analysis.rest_stability import unstable_posture
from tarc.certificates import Certificate
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.core.errors import InfeasibleDesign
from tarc.design import Design, choose_adaptation, design_controller, expected_step
from tarc.design.candidates import Candidate
from tarc.design.noise import measurement_deviation
from tarc.design.trial_motion import BASE_FREQUENCY
from tarc.plants.base import Plant
from tarc.simulation.run import Run

DATA = "cmeel.prefix/share/example-robot-data/robots"
DURATION = 10.0
GOAL = 20.0
"""Longest that a design should take [s]."""
ELSEWHERE, SMALL = 3.0, 0.1
"""Length [s] and amplitude [rad] of the motion where a loop is worst."""
TUBE = 0.05
"""About the motion, for the design that knows it [rad]."""
FRICTION_WIDTH = 0.02
"""Of the smooth sign of dry friction in a law that knows the robot [rad/s]."""
SAMPLES = 500
"""Postures, for the design and for the winners of the sweeps."""
WINDOWS = (3, 30)
SHARES = (0.01, 2.0)
"""M̂ swept over: of the mean inertia along the motion, its least diagonal element for m I."""
BANDWIDTHS = (2.0, 200.0)
TIE = 1.05
"""Errors that differ by less are about the same."""
NEAR = 0.3
"""Width of the box about the best so far, of the whole, in which the second half of a sweep looks."""


SPEED = 1.0
"""Of the joints [rad/s], where nothing less is said: what the designs are certified for, and the motion keeps."""


class Robot(NamedTuple):
    """An arm: file, rated payload [kg], rotor inertia [kg m²], joints if not all, speed [rad/s], home if another."""

    name: str
    file: str
    payload: float
    armature: float = 0.1
    joints: Sequence[str] | None = None
    fastest: float = SPEED
    home: Sequence[float] | None = None

    def plant(self) -> tarc.plants.Plant:
        is_shipped = "/" not in self.file
        file = self.file if is_shipped else Path(sysconfig.get_path("purelib")) / DATA / self.file
        home = None if self.home is None else np.array(self.home)
        return tarc.plants.load_robot(file, joints=self.joints, armature=self.armature, home=home)

    def speed(self) -> np.ndarray:
        """Greatest speed of each joint [rad/s]."""
        return np.minimum(self.plant().velocity_limits, self.fastest)


ROBOTS = (
    Robot("SO-101", "so_arm_description/urdf/so101.urdf", 0.3, 0.028),
    Robot("UR5", "ur_description/urdf/ur5_robot.urdf", 5.0),
    # at 1 rad/s the Panda is not certified with its 3 kg
    Robot(
        "Panda", "panda_description/urdf/panda.urdf", 3.0, joints=[f"panda_joint{i}" for i in range(1, 8)], fastest=0.5
    ),
    Robot("Kinova", "kinova_description/robots/kinova.urdf", 2.0),
    Robot("xArm7", "xarm_description/urdf/xarm7.urdf", 3.5),
    Robot("Z1", "z1_description/urdf/z1.urdf", 2.0),
)


OTHERS = (
    Robot("UR5e", "ur5e", 5.0),
    # outstretched, its second joint cannot hold 3 kg
    Robot(
        "TIAGo",
        "tiago_description/robots/tiago_no_hand.urdf",
        3.0,
        joints=[f"arm_{i}_joint" for i in range(1, 8)],
        home=[1.37, -1.2, 0.0, 0.0, 0.0, 0.0, 0.0],
    ),
)
"""Arms that are measured by name only."""


class Sweep(NamedTuple):
    """Which hand picks a sweep looks at."""

    name: str
    kinds: tuple[str, ...]
    free: bool = False
    checked: bool = False
    like_model: bool = False


SWEEPS = (
    Sweep("m I", ("m I",)),
    Sweep("m diag", ("m diag",)),
    Sweep("any ωn", ("m I", "m diag"), free=True),
    Sweep("checked", ("m I", "m diag"), free=True, checked=True),
)
"""M̂ = m I, one number for all joints. M̂ = m diag of the mean inertia along the motion. Both with the natural frequency
swept too. Those that are stable at rest in every sampled posture, with and without payload."""
LIKE_MODEL = Sweep("any ωn, as M̂(q)", ("m I", "m diag"), free=True, like_model=True)
"""Within the torque variation of the first design with M̂(q), which may be less."""


class Pick(NamedTuple):
    """A hand pick, the best that a sweep found, or the design for the motion; how it fares elsewhere. SI units."""

    sweep: str
    tried: int
    inertia: str = "–"
    window: float = np.nan
    natural_frequency: float = np.nan
    law: str = "–"
    error: float = np.nan
    variation: float = np.nan
    verdict: str = "none survived"
    margin: float = np.nan
    elsewhere: float = np.nan


@dataclass(frozen=True, kw_only=True)
class Result:
    """Everything about one robot; SI units.

    Attributes
    ----------
    wall, cpu
        What the design took [s].
    error, variation
        RMS error and torque variation of the run that picks the payload up.
    picked_up, loaded
        How the runs ended.
    predicted, measured
        RMS torque noise of each joint.
    shares
        The prediction over the torque limit.
    """

    name: str
    joints: int
    payload: float
    wall: float
    cpu: float
    spread: float
    scale: float
    window: float
    degree: int
    synchronised: bool
    natural_frequency: float
    verdict: str
    margin: float
    error: float
    variation: float
    picked_up: str
    loaded: str
    predicted: tuple[float, ...]
    measured: tuple[float, ...]
    shares: tuple[float, ...]
    picks: tuple[Pick, ...]

    @property
    def ratios(self) -> np.ndarray:
        """Torque noise measured over predicted, of each joint."""
        return np.array(self.measured) / np.array(self.predicted)


class Trial:
    """A design in its own scenario, where other laws may run as well."""

    def __init__(self, made: Design, duration: float = DURATION):
        self.made = made
        self.scenario = made.scenario(duration)
        self.plant: Plant = made.plants[0]
        self.reference = self.scenario.build_reference()
        self.events = self.scenario.build().events
        self.path = self.reference.sample(np.linspace(0, duration, 200))[0]

    def run(self, law: Any, *, loaded: bool = False, perfect: bool = False) -> Run:
        """Pick up the payload at half-time, or have it from the start."""
        plant = self.made.plants[-1] if loaded else self.plant
        return self._run(plant, law, self.reference, self.scenario.duration, () if loaded else self.events, perfect)

    def _run(
        self, plant: Plant, law: Any, reference: Any, duration: float, events: Sequence[Any] = (), perfect: bool = False
    ) -> Run:
        return tarc.simulate(
            plant,
            law,
            reference,
            duration,
            sensor=tarc.signals.Encoder() if perfect else self.made.sensor,
            disturbance=events,
            initial_torque="rest",
            computation_delay=self.scenario.computation_delay,
            progress=False,
        )

    def measures(self, run: Run) -> dict[str, float]:
        return run.metrics(self.scenario.metrics_start)

    def noise(self, run: Run) -> np.ndarray:
        """RMS of what the encoder adds to the torque [N m], shape (n,): the run against one with a perfect sensor."""
        torque = (run.data["torque"] - self.run(self.made.law, perfect=True).data["torque"]).values
        begin = round(self.scenario.metrics_start / self.scenario.period)
        return np.sqrt(np.mean(torque[begin:] ** 2, axis=0))

    def elsewhere(self, law: Any, certificate: Certificate) -> float:
        """Torque variation over the design's on small sines where the law's loop is worst; infinite if it is lost.

        The greatest of those about the posture that refutes it, or where the least and the greatest inertia ratio are,
        with every payload.
        """
        space = self.made.workspace
        points = certificate.evidence.points
        extremes = [points.min_ratio.position, points.max_ratio.position]
        where = [certificate.witness.posture] if certificate.witness else extremes
        amplitude = np.minimum(SMALL, (space.high - space.low) / 4)
        frequency = BASE_FREQUENCY * (1 + 0.2 * np.arange(len(amplitude)))
        greatest = 0.0
        for posture in where:
            middle = np.clip(posture, space.low + amplitude, space.high - amplitude)
            small = tarc.signals.Sinusoid(amplitude=amplitude, frequency=frequency, phase=np.pi / 2, offset=middle)
            for plant in self.made.plants:
                runs = [self._run(plant, one, small, ELSEWHERE) for one in (law, self.made.law)]
                if not runs[0].status.completed:
                    return np.inf
                its, own = (run.metrics(ELSEWHERE / 3)["torque_variation"] for run in runs)
                greatest = max(greatest, its / own)
        return greatest


def sweep(which: Sweep, trial: Trial, limit: float, budget: float) -> tuple[Pick, Any]:
    """Return the pick of least RMS error on the motion within a torque variation and a processor time [s], and its law.

    Points fill the box of inertia, window and natural frequency evenly, on a logarithmic scale. In the second half of
    the time they fill the box about the best pick.
    """
    made, period, delay = trial.made, trial.made.law.period, trial.scenario.computation_delay
    begin, tried, best, winner = time.process_time(), 0, Pick(which.name, 0), None
    mean = np.diag(trial.plant.mean_inertia(trial.path))
    shapes = {"m I": np.full(len(mean), mean.min()), "m diag": mean}
    options = [(kind, law) for law in literal(made.law) for kind in which.kinds]
    postures = made.workspace.sample(SAMPLES, 0).T
    centre, liked = np.zeros(3), options[0]
    while (spent := time.process_time() - begin) < budget:
        unit, (kind, base) = _spread_out(tried), options[tried % len(options)]
        if winner is not None and spent > budget / 2:
            unit, (kind, base) = np.clip(centre + NEAR * (unit - 0.5), 0, 1), liked
        ranges = zip(unit, (SHARES, WINDOWS, BANDWIDTHS), strict=True)
        share, window, natural_frequency = (float(low * (high / low) ** one) for one, (low, high) in ranges)
        natural_frequency = natural_frequency if which.free else made.candidate.natural_frequency
        estimator = tarc.estimators.Algebraic(window=round(window) * period, degree=2)
        law = replace(base, inertia=share * shapes[kind], natural_frequency=natural_frequency, estimator=estimator)
        tried += 1
        if which.checked and any(unstable_posture(law, plant, postures, delay) for plant in made.plants):
            continue
        run = trial.run(law)
        if not run.status.completed:
            continue
        found = trial.measures(run)
        better = winner is None or found["rms_error"] < best.error
        if better and found["torque_variation"] <= limit and trial.run(law, loaded=True).status.completed:
            centre, liked, winner = unit, (kind, base), law
            number = share * mean.min() if kind == "m I" else share
            best = Pick(
                which.name,
                tried,
                kind.replace("m", f"{number:.2g}", 1),
                round(window) * period,
                natural_frequency,
                type(law).__name__,
                found["rms_error"],
                found["torque_variation"],
            )
    return best._replace(tried=tried), winner


def for_motion(trial: Trial, limit: float, **options: Any) -> tuple[Pick, Any]:
    """Of the designs certified for a tube about the motion the one with the least error within a torque variation.

    Along the front, from less noise to less error, by simulated runs; then certified.
    """
    made, delay, blank = trial.made, trial.scenario.computation_delay, Pick("tube design", 0, verdict="none certified")
    tube = Workspace.from_reference(trial.reference, trial.scenario.duration, tube=TUBE)
    options = {"torque_limits": made.law.torque_limits, **options}
    try:
        found = design_controller(
            trial.plant, payload=made.payload, sensor=made.sensor, workspace=tube, progress=False, **options
        )
    except InfeasibleDesign:
        return blank, None
    expected, sigma = (
        expected_step(found.plants, tube),
        float(np.linalg.norm(measurement_deviation(made.sensor, trial.plant.n_joints))),
    )

    def law_of(one: Candidate) -> Any:
        gain = (
            {} if isinstance(found.law, tarc.laws.TDC) else choose_adaptation(one, expected, noise=sigma).law_options()
        )
        inertia = one.inertia_scale * found.shape
        return replace(found.law, inertia=inertia, estimator=one.estimator, **one.law_options(), **gain)

    def variation(one: Candidate) -> float:
        run = trial.run(law_of(one))
        return trial.measures(run)["torque_variation"] if run.status.completed else np.inf

    front = found.front
    count = bisect_right(front, limit, key=variation)
    for one in reversed(front[:count]):
        law = law_of(one)
        if certified(law, found.plants, tube, delay).certified:
            own, kind = trial.measures(trial.run(law)), f"{type(law).__name__}{'' if one.synchronised else ', literal'}"
            window, tried = one.window * one.period, len(found.candidates)
            values = own["rms_error"], own["torque_variation"], "in the tube"
            return Pick(blank.sweep, tried, "full", window, one.natural_frequency, kind, *values), law
    return blank, None


def certified(law: Any, plants: Sequence[Plant], workspace: Workspace, delay: int) -> Certificate:
    """Return the certificate of the robot, by balls or a Lyapunov function affine in the inertia."""
    given: dict[str, Any] = {"computation_delay": delay, "samples": SAMPLES}
    return strengthen_robot(certify_robot(law, plants, workspace, **given), law, plants, workspace, **given)


def _spread_out(index: int) -> np.ndarray:
    """Points that fill the unit cube evenly, one after the other: multiples of the powers of 1/1.2207, modulo 1."""
    return (0.5 + (index + 1) * 1.2207440846057596 ** -np.arange(1.0, 4.0)) % 1


def literal(law: Any) -> list[Any]:
    """Return the literal law, with its switching gain and without."""
    names = (
        "period",
        "estimator",
        "torque_limit",
        "inertia",
        "natural_frequency",
        "damping_ratio",
        "delay",
        "actuation_delay",
    )
    plain = tarc.laws.TDC(**{name: getattr(law, name) for name in names})
    return [plain] if isinstance(law, tarc.laws.TDC) else [replace(law, synchronised=False), plain]


def judged(pick: Pick, law: Any, trial: Trial) -> Pick:
    """With its verdict over the workspace and how it runs where its loop is worst."""
    if law is None:
        return pick
    made, delay = trial.made, trial.scenario.computation_delay
    found = certified(law, made.plants, made.workspace, delay)
    verdict = pick.verdict if pick.verdict == "in the tube" else found.verdict
    return pick._replace(verdict=verdict, margin=found.margin, elsewhere=trial.elsewhere(law, found))


def hand_pick(trial: Trial, which: Sweep, limit: float, budget: float, done: Callable[[str], object]) -> Pick:
    """Return the best pick of a sweep within a torque variation and a processor time [s]."""
    pick, law = sweep(which, trial, limit, budget)
    done(f"{pick.tried} hand picks, {which.name}")
    return judged(pick, law, trial)


def with_model(
    model: str,
    trial: Trial,
    payload: float,
    options: dict[str, Any],
    done: Callable[[str], object],
    noise: float | None = None,
) -> Pick:
    """Design with M̂(q) of the robot's file, run on the motion of the design without a model.

    With ``noise``, its torque may change so much per period by noise, over the torque limit.
    """
    sweep, begin = f"M̂(q), {model}" + ("" if noise is None else f", {100 * noise:g} % noise"), time.process_time()
    try:
        made = design_controller(
            trial.plant,
            payload=(0.0, payload),
            progress=False,
            model=model,
            friction_width=FRICTION_WIDTH,
            noise_budget=noise,
            **options,
        )
    except InfeasibleDesign as error:
        done(f"no design, {sweep}: {error}")
        return Pick(sweep, 0, verdict="no design")
    done(f"designed, {sweep}, in {time.process_time() - begin:.0f} s of processor time")
    law, run = made.law, trial.run(made.law)
    found, inertia = trial.measures(run), law.inertia
    assert isinstance(inertia, tarc.NominalInertia)
    verdict = made.certificates["robot"]
    return Pick(
        sweep,
        len(made.candidates),
        f"{inertia.fraction:.2g} M(q)",
        made.estimator.window,
        made.candidate.natural_frequency,
        type(law).__name__ + ("" if law.synchronised else ", literal"),
        found["rms_error"] if run.status.completed else np.nan,
        found["torque_variation"] if run.status.completed else np.nan,
        verdict.verdict,
        verdict.margin,
    )


def measure(
    name: str,
    plant: Plant,
    payload: float,
    *,
    sweeps: Sequence[Sweep] = SWEEPS,
    budget: float | None = None,
    motion: bool = True,
    models: Sequence[str] = (),
    noises: Sequence[float] = (),
    duration: float = DURATION,
    done: Callable[[str], object] = lambda text: None,
    **options: Any,
) -> Result:
    """Design, run and compare.

    Parameters
    ----------
    name, plant, payload
        The robot and its greatest payload [kg].
    sweeps, budget
        What hand picks, and the processor time for each of them [s]; None for that of the design.
    motion
        Whether to design for the motion as well.
    models
        What laws with M̂(q) know of the robot, ``inertia`` or ``known``; each is designed and run as well.
    noises
        Further designs with M̂(q): change of the torque per period by noise that they may have, over its limit.
    duration
        Of the runs [s].
    done
        Called with a sentence after each part, to show progress.
    options
        Of `tarc.design.design_controller`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tarc.DesignWarning)  # the tables tell how it went
        wall, cpu = time.perf_counter(), time.process_time()
        options = {"samples": SAMPLES, **options}
        made = design_controller(plant, payload=(0.0, payload), progress=False, **options)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        done(f"designed in {wall:.0f} s")
        trial = Trial(made, duration)
        run, loaded = trial.run(made.law), trial.run(made.law, loaded=True)
        own, verdict = trial.measures(run), made.certificates["robot"]
        modelled = [
            with_model(model, trial, payload, options, done, noise) for model in models for noise in (None, *noises)
        ]
        picks = []
        for one in sweeps:
            limit = modelled[0].variation if one.like_model else own["torque_variation"]
            picks.append(hand_pick(trial, one, limit, cpu if budget is None else budget, done))
        if motion:
            picks.append(judged(*for_motion(trial, own["torque_variation"], **options), trial))
            done("designed for the motion")
        picks += modelled
        chosen, limits = made.candidate, np.asarray(made.law.torque_limits, dtype=float)
        return Result(
            name=name,
            joints=plant.n_joints,
            payload=payload,
            wall=wall,
            cpu=cpu,
            spread=made.spread,
            scale=chosen.inertia_scale,
            window=chosen.window * chosen.period,
            degree=chosen.degree,
            synchronised=chosen.synchronised,
            natural_frequency=chosen.natural_frequency,
            verdict=verdict.verdict,
            margin=verdict.margin,
            error=own["rms_error"],
            variation=own["torque_variation"],
            picked_up=str(run.status),
            loaded=str(loaded.status),
            predicted=tuple(made.torque_noise.tolist()),
            measured=tuple(trial.noise(run).tolist()),
            shares=tuple((made.torque_noise / limits).tolist()),
            picks=tuple(picks),
        )


def measure_robot(
    which: Robot,
    sweeps: Sequence[Sweep] = SWEEPS,
    models: Sequence[str] = ("inertia", "known"),
    noises: Sequence[float] = (),
) -> Result | str:
    """One of `ROBOTS`, or why it has no design; progress on standard error.

    The design for the motion is measured with all sweeps only.
    """
    console = Console(stderr=True)

    def done(text: str) -> None:
        console.print(f"{which.name}: {text}", style="dim", highlight=False)

    try:
        return measure(
            which.name,
            which.plant(),
            which.payload,
            sweeps=sweeps,
            motion=len(sweeps) == len(SWEEPS),
            models=models,
            noises=noises,
            done=done,
            speed=which.speed(),
        )
    except InfeasibleDesign as error:
        done(f"no design: {error}")
        return str(error)


class Sheet(NamedTuple):
    """A table: title, heads, rows of text, what to know about it."""

    title: str
    heads: list[str]
    rows: list[list[str]]
    note: str


def sheets(found: Sequence[Result]) -> list[Sheet]:
    """All tables."""
    return [_designs(found), _noise(found), _picks(found)]


def _designs(found: Sequence[Result]) -> Sheet:
    heads = ["robot,\njoints", "payload\n[kg]", "time [s]", "spread", "window\n[ms]", "ωn\n[rad/s]", "scale"]
    heads += ["noise\n[% of limit]", "verdict", "margin", "both runs"]
    rows = []
    for one in found:
        loudest = int(np.argmax(one.shares))
        window = f"{1e3 * one.window:.3g}{'' if one.degree == 2 else f', Λ {one.degree}'}"
        same = one.picked_up == one.loaded
        rows.append(
            [
                f"{one.name}, {one.joints}",
                f"{one.payload:g}",
                f"{one.wall:.0f}, CPU {one.cpu:.0f}",
                f"{one.spread:.3g}",
                window + ("" if one.synchronised else ", literal"),
                f"{one.natural_frequency:.3g}",
                f"{one.scale:.3g}",
                f"{100 * one.shares[loudest]:.2g}, joint {loudest + 1}",
                one.verdict,
                f"{one.margin:.1g}",
                one.picked_up if same else f"{one.picked_up}; {one.loaded}",
            ]
        )
    note = (
        "Synchronised unless it says literal. Spread: of the eigenvalues of M(q)⁻¹M̂ over workspace and payload. Scale: "
        "the least of them. Noise: predicted RMS torque, of the joint where its share of the limit is greatest. Runs: "
        "with the payload picked up at half-time, and with it from the start."
    )
    return Sheet("Certified designs", heads, rows, note)


def _noise(found: Sequence[Result]) -> Sheet:
    count = max(one.joints for one in found)
    heads = ["robot", *(f"joint {i + 1}" for i in range(count)), "within\ntwo"]
    rows = []
    for one in found:
        cells = [f"{ratio:.2f} ({size:.2g})" for ratio, size in zip(one.ratios, one.predicted, strict=True)]
        rows.append([one.name, *cells, *[""] * (count - one.joints), "yes" if within(one) else "no"])
    note = (
        "Measured: RMS of the torque with the encoder less that with a perfect sensor, after 1 s, in the run that "
        "picks the payload up. In brackets the prediction [N m], which is for the worst posture."
    )
    return Sheet("Torque noise, measured over predicted", heads, rows, note)


def within(one: Result) -> bool:
    """Whether the torque noise of every joint is within a factor of two of the prediction."""
    return bool(np.all((one.ratios > 0.5) & (one.ratios < 2)))


def _picks(found: Sequence[Result]) -> Sheet:
    heads = [
        "",
        "tried",
        "M̂",
        "window\n[ms]",
        "ωn\n[rad/s]",
        "law",
        "error",
        "torque\nvariation",
        "verdict",
        "elsewhere",
    ]
    rows = []
    for one in found:
        rows.append(
            [
                f"{one.name}: design",
                "",
                "",
                f"{1e3 * one.window:.3g}",
                f"{one.natural_frequency:.3g}",
                "",
                f"{1e3 * one.error:.2g} mrad",
                f"{one.variation:.0f} N m/s",
                one.verdict,
                "",
            ]
        )
        for pick in one.picks:
            rows.append(
                [
                    f"{one.name}: {pick.sweep}",
                    f"{pick.tried}",
                    pick.inertia,
                    f"{1e3 * pick.window:.3g}",
                    f"{pick.natural_frequency:.3g}",
                    pick.law,
                    f"{pick.error / one.error:.2f}×",
                    f"{pick.variation / one.variation:.2f}×",
                    pick.verdict,
                    _times(pick.elsewhere),
                ]
            )
    note = (
        "Error and torque variation over the design's, on the motion that the picks were swept on: above 1 the design "
        "has less. m I: one number for all joints; m diag: m times the mean inertia along the motion; any ωn: either, "
        "with the natural frequency swept too; checked: of those the stable at rest in all sampled postures. "
        "M̂(q): designs with a model, with their own torque variation. Tube design: "
        f"certified within {TUBE:g} rad of the motion alone. Verdict: over the workspace and both payloads. Elsewhere: "
        "torque variation over the design's on small sines where the loop is worst in the workspace."
    )
    return Sheet("Hand picks within the design's torque variation and processor time", heads, rows, note)


def _times(ratio: float) -> str:
    return "–" if np.isnan(ratio) else "lost" if np.isinf(ratio) else f"{ratio:.2g}×"


def verdicts(found: Sequence[Result]) -> list[str]:
    """Goals met and missed, wins and losses, in sentences."""

    def named(some: Sequence[str]) -> str:
        return ", ".join(some) or "none"

    times, ratios = [one.cpu for one in found], np.concatenate([one.ratios for one in found])
    lines = [
        f"Time: {min(times):.0f} to {max(times):.0f} s of processor time a design; more than {GOAL:.0f} s: "
        f"{named([one.name for one in found if one.cpu > GOAL])}.",
        f"Torque noise: {ratios.min():.2f} to {ratios.max():.2f} of the prediction; not within a factor of two: "
        f"{named([one.name for one in found if not within(one)])}.",
    ]
    for name in dict.fromkeys(pick.sweep for one in found for pick in one.picks):
        pairs = [(one, pick) for one in found for pick in one.picks if pick.sweep == name]
        known = [(one.name, pick.error / one.error) for one, pick in pairs if np.isfinite(pick.error)]
        less = named([f"{robot} ({ratio:.2f})" for robot, ratio in known if ratio < 1 / TIE])
        more = named([f"{robot} ({ratio:.2f})" for robot, ratio in known if ratio > TIE])
        same = [robot for robot, ratio in known if 1 / TIE <= ratio <= TIE]
        told = [pick.verdict for _, pick in pairs]
        counts = ", ".join(f"{told.count(one)} {one}" for one in dict.fromkeys(told))
        alike = f", about as much on {named(same)}" if same else ""
        lines.append(f"{name}: more error than the design on {more}, less on {less}{alike}. Verdicts: {counts}.")
    return lines


def markdown(found: Sequence[Result], failures: dict[str, str]) -> str:
    """Return the tables for the documentation."""
    lines = []
    for sheet in sheets(found) if found else ():
        lines += [f"{sheet.title}:", ""]
        heads = [head.replace("\n", " ") for head in sheet.heads]
        lines += [f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *sheet.rows)]
        lines += ["", sheet.note, ""]
    lines += [f"- {one}" for one in verdicts(found)] if found else []
    return "\n".join([*lines, *(f"- {name}: no design. {why}" for name, why in failures.items()), ""])


def write(found: Sequence[Result], failures: dict[str, str], folder: Path) -> None:
    """Markdown, and tables of plain numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "design.md").write_text(markdown(found, failures), encoding="utf-8")
    own = [one.name for one in fields(Result) if one.type in (str, int, float, bool)]
    tables: dict[str, list[dict[str, Any]]] = {
        "designs": [{name: getattr(one, name) for name in own} for one in found],
        "noise": [
            {"name": one.name, "joint": i + 1, "predicted": one.predicted[i], "measured": one.measured[i]}
            for one in found
            for i in range(one.joints)
        ],
        "picks": [{"name": one.name, **pick._asdict()} for one in found for pick in one.picks],
    }
    for name, rows in tables.items():
        with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else ["name"], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def show(found: Sequence[Result], failures: dict[str, str], console: Console) -> None:
    """Print the tables and what they say."""
    for sheet in sheets(found) if found else ():
        table = Table(title=sheet.title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for head in sheet.heads:
            table.add_column(head, no_wrap=head != "both runs")
        table.title_justify = table.caption_justify = "left"
        table.caption = sheet.note
        for cells in sheet.rows:
            table.add_row(*cells)
        console.print(table)
    for line in verdicts(found) if found else ():
        console.print(line, highlight=False)
    for name, why in failures.items():
        console.print(f"{name}: no design. {why}", highlight=False, style="red")


def main() -> None:
    """Run, print and write."""
    names = ", ".join(one.name for one in (*ROBOTS, *OTHERS))
    parser = argparse.ArgumentParser(prog="python -m benchmarks.design", description=__doc__)
    parser.add_argument("--robots", default="all", help=f"some of {names}, with commas between; all is the first six")
    parser.add_argument("--no-picks", action="store_true", help="the designs alone, in two minutes")
    sweeps = [one.name for one in (*SWEEPS, LIKE_MODEL)]
    parser.add_argument("--sweep", choices=sweeps, help="hand picks by this sweep alone, and no design for the motion")
    parser.add_argument("--models", default="inertia,known", help="what laws with M̂(q) know; empty for none")
    parser.add_argument("--noise", default="", help="further designs with M̂(q), with so much torque noise [%%], as 2,3")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("runs/design"))
    options = parser.parse_args()
    named = [one for one in (*ROBOTS, *OTHERS) if one.name in options.robots.split(",")]
    wanted = list(ROBOTS) if options.robots == "all" else named
    if not wanted:
        parser.error(f"--robots: got {options.robots!r}; needs some of {names}")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each process that measures has a core to itself
    begin, answers = time.perf_counter(), {}
    models = tuple(name for name in options.models.split(",") if name)
    if options.sweep == LIKE_MODEL.name and not models:
        parser.error(f"--sweep {LIKE_MODEL.name!r}: needs --models inertia, known or both")
    chosen = (
        list(SWEEPS) if options.sweep is None else [one for one in (*SWEEPS, LIKE_MODEL) if one.name == options.sweep]
    )
    chosen = [] if options.no_picks else chosen
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        noises = tuple(float(percent) / 100 for percent in options.noise.split(",") if percent)
        futures = {pool.submit(measure_robot, one, chosen, models, noises): one.name for one in wanted}
        for future in as_completed(futures):
            answers[futures[future]] = future.result()
    found = [one for name in wanted if isinstance(one := answers[name.name], Result)]
    failures = {one.name: why for one in wanted if isinstance(why := answers[one.name], str)}
    console = Console(width=None if Console().is_terminal else 110)
    show(found, failures, console)
    write(found, failures, options.out)
    console.print(f"written: {options.out}/design.md, CSV beside it; {time.perf_counter() - begin:.0f} s", style="dim")


if __name__ == "__main__":
    main()
