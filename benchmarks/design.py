"""What `tarc.design.design` is worth on six arms: ``python -m benchmarks.design``, or ``make bench-design``.

For each arm of example-robot-data a certified design at 1 kHz with 17-bit encoders, and its time; the runs with the
greatest payload; the torque noise that was predicted against that of the runs; and hand picks. A hand pick is the
literal law with the inertia, the window and, where it says so, the bandwidth that a sweep of simulated runs found best
for that very motion, within the torque variation of the design and the processor time that the design took. It is lent
the design's switching gain, and may do without. The design has the whole workspace in its proof and the sweep one
motion, so each winner is certified over the workspace as well, and held where its inertia ratio is worst.

As the sweeps go by time, their numbers change a little from run to run.
"""

import argparse
import csv
import os
import sysconfig
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

import tarc
from tarc.certificates import Certificate, stable_intervals
from tarc.certificates.robot import mismatches, robot, sampled, unstable_posture
from tarc.design import Design, assess, design
from tarc.design.choose import ROOM, SLOPE
from tarc.design.front import Candidate, Demand
from tarc.plants.base import Plant
from tarc.run import Run

DATA = "cmeel.prefix/share/example-robot-data/robots"
DURATION = 10.0
HOLD = 3.0
"""How long an arm is held where a loop is worst [s]."""
SAMPLES = 500
"""Postures, for the design and for the winners of the sweeps."""
WINDOWS = (3, 30)
SHARES = (0.01, 2.0)
"""M̂ swept over: of the mean inertia along the motion, its least diagonal element for m I."""
BANDWIDTHS = (2.0, 200.0)
NEAR = 0.3
"""Width of the box about the best so far, of the whole, in which the second half of a sweep looks."""


class Robot(NamedTuple):
    """An arm: its file, rated payload [kg], rotor inertia [kg m²], joints if not all."""

    name: str
    file: str
    payload: float
    armature: float = 0.1
    joints: Sequence[str] | None = None

    def plant(self) -> tarc.plants.MujocoPlant:
        file = Path(sysconfig.get_path("purelib")) / DATA / self.file
        return tarc.plants.MujocoPlant.from_file(file, joints=self.joints, armature=self.armature)


ROBOTS = (
    Robot("SO-101", "so_arm_description/urdf/so101.urdf", 0.3, 0.028),
    Robot("UR5", "ur_description/urdf/ur5_robot.urdf", 5.0),
    Robot("Panda", "panda_description/urdf/panda.urdf", 3.0, joints=[f"panda_joint{i}" for i in range(1, 8)]),
    Robot("Kinova", "kinova_description/robots/kinova.urdf", 2.0),
    Robot("xArm7", "xarm_description/urdf/xarm7.urdf", 3.5),
    Robot("Z1", "z1_description/urdf/z1.urdf", 2.0),
)


class Sweep(NamedTuple):
    """Which hand picks a sweep looks at."""

    name: str
    kinds: tuple[str, ...]
    free: bool = False
    everywhere: bool = False


SWEEPS = (
    Sweep("m I", ("m I",)),
    Sweep("m diag", ("m diag",)),
    Sweep("any bandwidth", ("m I", "m diag"), free=True),
    Sweep("…, stable everywhere", ("m I", "m diag"), free=True, everywhere=True),
)
"""M̂ = m I, one number for all joints; M̂ = m diag of the mean inertia along the motion; these with the bandwidth swept
too; and those among them that are stable at rest in every sampled posture, with and without payload."""


class Pick(NamedTuple):
    """A hand pick: what the best was, against the design; how it fares elsewhere."""

    sweep: str
    runs: int
    inertia: str = ""
    window: float = np.nan
    bandwidth: float = np.nan
    law: str = ""
    error: float = np.nan
    variation: float = np.nan
    verdict: str = "none survived"
    margin: float = np.nan
    held: float = np.nan
    """Greatest error at rest where the inertia ratio is worst [rad]."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """Everything about one robot; SI units."""

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
    bandwidth: float
    verdict: str
    margin: float
    error: float
    variation: float
    held: float
    picked_up: str
    loaded: str
    predicted: tuple[float, ...]
    """Torque noise of each joint [N m]."""
    measured: tuple[float, ...]
    shares: tuple[float, ...]
    """Predicted torque noise over the torque limit."""
    picks: tuple[Pick, ...]
    ceilings: dict[str, float]

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
        self.events = self.scenario.build_disturbances()
        self.path = self.reference.sample(np.linspace(0, duration, 200))[0]

    def run(self, law: Any, *, loaded: bool = False, perfect: bool = False) -> Run:
        """Pick up the payload at half-time, or have it from the start."""
        return tarc.simulate(
            self.made.plants[-1] if loaded else self.plant, law, self.reference, self.scenario.duration,
            sensor=tarc.signals.Encoder() if perfect else self.made.sensor,
            disturbance=() if loaded else self.events, torque="rest",
            computation_delay=self.scenario.computation_delay, progress=False,
        )  # fmt: skip

    def measures(self, run: Run) -> dict[str, float]:
        return run.metrics(self.scenario.measure_from)

    def noise(self, run: Run) -> np.ndarray:
        """RMS of what the encoder adds to the torque [N m], shape (n,): the run against one with a perfect sensor."""
        torque = (run.data["torque"] - self.run(self.made.law, perfect=True).data["torque"]).values
        begin = round(self.scenario.measure_from / self.scenario.period)
        return np.sqrt(np.mean(torque[begin:] ** 2, axis=0))

    def held(self, law: Any, certificate: Certificate) -> float:
        """Greatest error [rad] when held at rest where the least and the greatest inertia ratio are, infinite if lost.

        Of the last third; with every payload.
        """
        worst = 0.0
        for name in ("posture_low", "posture_high"):
            still = tarc.signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=certificate.matrices[name])
            for plant in self.made.plants:
                run = tarc.simulate(
                    plant, law, still, HOLD, sensor=self.made.sensor, torque="rest",
                    computation_delay=self.scenario.computation_delay, progress=False,
                )  # fmt: skip
                if not run.status.completed:
                    return np.inf
                worst = max(worst, run.metrics(2 / 3 * HOLD)["peak_error"])
        return worst


def sweep(which: Sweep, trial: Trial, limit: float, budget: float, seed: int = 0) -> tuple[Pick, Any]:
    """The least RMS error on the motion within a torque variation and so much processor time [s].

    Points that fill the box of inertia, window and bandwidth evenly, on a logarithmic scale; in the second half of the
    time, the box about the best so far.
    """
    from scipy.stats import qmc

    made, period = trial.made, trial.made.law.period
    begin, runs, best, winner = time.process_time(), 0, Pick(which.name, 0), None
    mean = np.diag(trial.plant.mean_inertia(trial.path))
    shapes = {"m I": np.full(len(mean), mean.min()), "m diag": mean}
    options = [(kind, law) for law in (made.law, plain(made.law)) for kind in which.kinds]
    postures = made.workspace.sample(SAMPLES, seed).T if which.everywhere else np.zeros((len(mean), 0))
    source, centre, liked = qmc.Sobol(3, seed=seed), np.zeros(3), options[0]
    while (spent := time.process_time() - begin) < budget:
        unit, (kind, base) = source.random(1)[0], options[runs % len(options)]
        if winner is not None and spent > budget / 2:
            unit, (kind, base) = np.clip(centre + NEAR * (unit - 0.5), 0, 1), liked
        share, window, bandwidth = (
            float(low * (high / low) ** one)
            for one, (low, high) in zip(unit, (SHARES, WINDOWS, BANDWIDTHS), strict=True)
        )
        bandwidth = bandwidth if which.free else made.chosen.bandwidth
        estimator = tarc.estimators.Algebraic(window=round(window) * period, degree=2)
        law = replace(base, inertia=share * shapes[kind], bandwidth=bandwidth, estimator=estimator)
        runs += 1
        delay = trial.scenario.computation_delay
        if which.everywhere and any(unstable_posture(law, plant, postures, delay) for plant in made.plants):
            continue
        run = trial.run(law)
        if not run.status.completed:
            continue
        found = trial.measures(run)
        better = winner is None or found["rms_error"] < best.error
        if better and found["torque_variation"] <= limit and trial.run(law, loaded=True).status.completed:
            centre, liked, winner = unit, (kind, base), law
            number = f"{share * shapes[kind][0]:.3g}" if kind == "m I" else f"{share:.3g}"
            best = Pick(
                which.name, runs, kind.replace("m", number, 1), round(window) * period, bandwidth, type(law).__name__,
                found["rms_error"], found["torque_variation"],
            )  # fmt: skip
    return best._replace(runs=runs), winner


def plain(law: Any) -> tarc.laws.TDC:
    """The same without the switching gain, literal like the picks with it."""
    names = ("period", "estimator", "torque_limit", "inertia", "bandwidth", "damping", "actuation_delay")
    return tarc.laws.TDC(**{name: getattr(law, name) for name in names})


def judged(pick: Pick, law: Any, trial: Trial) -> Pick:
    """With its verdict over the workspace and how it holds still where the inertia ratio is worst."""
    if law is None:
        return pick
    made = trial.made
    delay = trial.scenario.computation_delay
    found = robot(law, made.plants, made.workspace, computation_delay=delay, samples=SAMPLES)
    return pick._replace(verdict=found.verdict, margin=found.margin, held=trial.held(law, found))


def ceilings(made: Design) -> dict[str, float]:
    """The greatest bandwidth [rad/s] at the window chosen, as each thing that the certificate asks for is left out."""
    chosen, n = made.chosen, len(made.shape)
    E, H = mismatches(made.shape, sampled(made.plants, made.workspace, SAMPLES, 0))
    full, light = Demand.of(made.spread, E, H), Demand.plain(made.spread)
    slope = chosen.slope / chosen.bandwidth**2
    assert n and (slope == 0 or np.isclose(slope, SLOPE))

    def at(speed: float) -> Candidate:
        return replace(chosen, bandwidth=speed, scale=0.0)

    def ball(demand: Demand, share: float, room: float) -> Callable[[float], bool]:
        return lambda speed: any(one.feasible for one in assess([at(speed)], demand, slope_share=share, room=room))

    def still(speed: float) -> bool:
        law = tarc.laws.TDC(inertia=1.0, estimator=chosen.estimator, **at(speed).options())
        intervals = stable_intervals(law, computation_delay=chosen.computation_delay)
        return any(high >= made.spread * low for low, high in intervals)

    tests = {
        "as certified": ball(full, slope, ROOM),
        "no switching gain": ball(full, 0.0, ROOM),
        "nor room": ball(full, 0.0, 0.0),
        "nor gravity": ball(light, 0.0, 0.0),
        "M(q) constant": still,
    }
    return {name: _greatest(test, chosen.bandwidth) for name, test in tests.items()}


def _greatest(test: Callable[[float], bool], start: float) -> float:
    """To about a hundredth, upwards from a bandwidth [rad/s] that does."""
    low, high = start, start
    while high < 64 * start and test(high := 2 * high):
        low = high
    for _ in range(6):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if test(middle) else (low, middle)
    return low


def measure(
    name: str,
    plant: Plant,
    payload: float,
    *,
    sweeps: Sequence[Sweep] = SWEEPS,
    budget: float | None = None,
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
        Processor time of each sweep [s]; None for that of the design.
    duration
        Of the runs [s].
    done
        Called with a sentence after each part, to show progress.
    options
        Of `tarc.design.design`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tarc.DesignWarning)  # the tables tell how it went
        begin = time.perf_counter(), time.process_time()
        made = design(plant, payload=(0.0, payload), progress=False, **{"samples": SAMPLES, **options})
        wall, cpu = time.perf_counter() - begin[0], time.process_time() - begin[1]
        done(f"designed in {wall:.0f} s")
        trial = Trial(made, duration)
        run, loaded = trial.run(made.law), trial.run(made.law, loaded=True)
        own, verdict = trial.measures(run), made.certificates["robot"]
        measured = trial.noise(run)
        picks = []
        for one in sweeps:
            pick, law = sweep(one, trial, own["torque_variation"], cpu if budget is None else budget)
            picks.append(judged(pick, law, trial))
            done(f"{pick.runs} hand picks, {one.name}")
        chosen, limit = made.chosen, np.asarray(made.law.limit, dtype=float)
        return Result(
            name=name, joints=plant.joints, payload=payload, wall=wall, cpu=cpu, spread=made.spread,
            scale=chosen.scale, window=chosen.window * chosen.period, degree=chosen.degree,
            synchronised=chosen.synchronised, bandwidth=chosen.bandwidth, verdict=verdict.verdict,
            margin=verdict.margin, error=own["rms_error"], variation=own["torque_variation"],
            held=trial.held(made.law, verdict), picked_up=str(run.status), loaded=str(loaded.status),
            predicted=tuple(made.torque_noise), measured=tuple(measured), shares=tuple(made.torque_noise / limit),
            picks=tuple(picks), ceilings=ceilings(made),
        )  # fmt: skip


def measure_robot(which: Robot) -> Result:
    """One of `ROBOTS`, with progress on standard error."""
    console = Console(stderr=True)
    return measure(
        which.name, which.plant(), which.payload,
        done=lambda text: console.print(f"{which.name}: {text}", style="dim", highlight=False),
    )  # fmt: skip


class Sheet(NamedTuple):
    """A table: title, heads, rows of text, and what to know about it."""

    title: str
    heads: list[str]
    rows: list[list[str]]
    note: str = ""


def sheets(found: Sequence[Result]) -> list[Sheet]:
    """All tables."""
    return [_designs(found), _noise(found), _picks(found), _ceilings(found)]


def _designs(found: Sequence[Result]) -> Sheet:
    heads = ["robot", "payload [kg]", "time, CPU [s]", "spread", "loop", "ωn [rad/s]", "scale", "noise [% of limit]"]
    heads += ["verdict, margin", "runs"]
    rows = []
    for one in found:
        loudest = int(np.argmax(one.shares))
        loop = f"{'synchronised' if one.synchronised else 'literal'}, {1e3 * one.window:.3g} ms"
        loop += "" if one.degree == 2 else f", degree {one.degree}"
        runs = one.picked_up if one.picked_up == one.loaded else f"{one.picked_up}; loaded {one.loaded}"
        rows.append([
            f"{one.name}, {one.joints} joints", f"{one.payload:g}", f"{one.wall:.0f}, {one.cpu:.0f}",
            f"{one.spread:.3g}", loop, f"{one.bandwidth:.3g}", f"{one.scale:.3g}",
            f"{100 * one.shares[loudest]:.2g} (joint {loudest + 1})", f"{one.verdict}, {one.margin:.2g}", runs,
        ])  # fmt: skip
    note = (
        "Noise as predicted, of the joint where its share is greatest. Runs: payload at half-time, and from the start."
    )
    return Sheet("Certified designs", heads, rows, note)


def _noise(found: Sequence[Result]) -> Sheet:
    count = max(one.joints for one in found)
    heads = ["robot", *(f"{i + 1}" for i in range(count)), "within two"]
    rows = []
    for one in found:
        cells = [f"{ratio:.2f} of {expected:.2g}" for ratio, expected in zip(one.ratios, one.predicted, strict=True)]
        within = bool(np.all((one.ratios > 0.5) & (one.ratios < 2)))
        rows.append([one.name, *cells, *[""] * (count - one.joints), "yes" if within else "no"])
    note = "RMS of the torque with the encoder less that with a perfect sensor, payload at half-time, after 1 s."
    return Sheet("Torque noise of each joint: measured over predicted, of the prediction [N m]", heads, rows, note)


def _picks(found: Sequence[Result]) -> Sheet:
    heads = ["robot", "hand pick", "runs", "M̂ [kg m²]", "window [ms]", "ωn", "law", "error", "torque variation"]
    heads += ["verdict", "held at its worst [mrad]"]
    rows = []
    for one in found:
        own = f"{1e3 * one.error:.3g} mrad", f"{one.variation:.3g} N m/s"
        rows.append([
            one.name, "the design", "", "", f"{1e3 * one.window:.3g}", f"{one.bandwidth:.3g}", "", *own, one.verdict,
            _mrad(one.held),
        ])  # fmt: skip
        for pick in one.picks:
            values = [f"{pick.error / one.error:.2f}×", f"{pick.variation / one.variation:.2f}×"]
            what = [pick.inertia, f"{1e3 * pick.window:.3g}", f"{pick.bandwidth:.3g}", pick.law, *values]
            known = np.isfinite(pick.error)
            cells = what if known else ["–"] * len(what)
            rows.append(["", pick.sweep, f"{pick.runs}", *cells, pick.verdict, _mrad(pick.held) if known else "–"])
    note = (
        "Error and torque variation as multiples of the design's, on the motion that the picks were swept on; above 1 "
        "the design has less error. Verdict over the whole workspace and both payloads; held at rest in the postures "
        "with the least and the greatest ratio of inertias, greatest error."
    )
    return Sheet("Hand picks within the design's torque variation and processor time", heads, rows, note)


def _mrad(error: float) -> str:
    return "lost" if not np.isfinite(error) else f"{1e3 * error:.2g}"


def _ceilings(found: Sequence[Result]) -> Sheet:
    names = list(found[0].ceilings)
    rows = [[one.name, f"{one.bandwidth:.3g}", *(f"{one.ceilings[name]:.3g}" for name in names)] for one in found]
    note = "Each column leaves out one thing more. The last bears every inertia of the workspace, if it never changes."
    heads = ["robot", "chosen", *names]
    return Sheet("What holds the bandwidth back at the window chosen [rad/s]", heads, rows, note)


def verdicts(found: Sequence[Result]) -> list[str]:
    """Wins and losses, in sentences."""
    lines = []
    for which in SWEEPS:
        picks = {one.name: (one, pick) for one in found for pick in one.picks if pick.sweep == which.name}
        if not picks:
            continue
        won = [name for name, (one, pick) in picks.items() if not pick.error < one.error]
        lost = [name for name in picks if name not in won]
        counts = [pick.verdict for _, pick in picks.values()]
        told = ", ".join(f"{counts.count(one)} {one}" for one in dict.fromkeys(counts))
        text = f"{which.name}: the design has less error on {', '.join(won) or 'none'}"
        lines.append(f"{text}; the pick on {', '.join(lost) or 'none'}. Of the picks {told}.")
    return lines


def markdown(found: Sequence[Result]) -> str:
    """The tables for the documentation."""
    lines = []
    for sheet in sheets(found):
        lines += [
            f"{sheet.title}:",
            "",
            f"| {' | '.join(sheet.heads)} |",
            f"| {' | '.join('---' for _ in sheet.heads)} |",
        ]
        lines += [f"| {' | '.join(cells)} |" for cells in sheet.rows]
        lines += ["", *([sheet.note, ""] if sheet.note else [])]
    return "\n".join([*lines, *(f"- {one}" for one in verdicts(found)), ""])


def write(found: Sequence[Result], folder: Path) -> None:
    """Markdown and three tables of plain numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "design.md").write_text(markdown(found), encoding="utf-8")
    lists = ("picks", "ceilings", "predicted", "measured", "shares")
    flat = [{key: value for key, value in vars(one).items() if key not in lists} for one in found]
    noise = [
        {"robot": one.name, "joint": i + 1, "predicted": one.predicted[i], "measured": one.measured[i]}
        for one in found
        for i in range(one.joints)
    ]
    picks = [{"robot": one.name, **pick._asdict()} for one in found for pick in one.picks]
    limits = [{"robot": one.name, **one.ceilings} for one in found]
    for name, rows in {"designs": flat, "noise": noise, "picks": picks, "bandwidths": limits}.items():
        with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.design", description=__doc__)
    parser.add_argument(
        "--robots", default="all", help=f"names with commas between: {', '.join(r.name for r in ROBOTS)}"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("runs/design"))
    options = parser.parse_args()
    wanted = [one for one in ROBOTS if options.robots == "all" or one.name in options.robots.split(",")]
    if not wanted:
        parser.error(f"--robots: none of {', '.join(one.name for one in ROBOTS)}")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for the processes that measure: one core each
    begin, found = time.perf_counter(), {}
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(measure_robot, one): one.name for one in wanted}
        for future in as_completed(futures):
            found[futures[future]] = future.result()
    ordered = [found[one.name] for one in wanted]
    console = Console(width=None if Console().is_terminal else 110)
    for sheet in sheets(ordered):
        table = Table(*sheet.heads, title=sheet.title, title_justify="left", caption=sheet.note, caption_justify="left")
        for cells in sheet.rows:
            table.add_row(*cells)
        console.print(table)
    for line in verdicts(ordered):
        console.print(line, highlight=False)
    write(ordered, options.out)
    console.print(f"written: {options.out}/design.md, CSV beside it; {time.perf_counter() - begin:.0f} s", style="dim")


if __name__ == "__main__":
    main()
