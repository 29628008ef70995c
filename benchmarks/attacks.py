"""Certified natural frequencies against those that attacks break: ``python -m benchmarks.attacks [ROBOT …]``.

For eight arms with their rated load at 1 rad/s, at the M̂, window and degree of a design, the greatest natural frequency
that is certified is compared with the greatest that no attack breaks. The attacks are motions of the robot about which
the linearised loop grows, bred by evolution (``tests/reference/motion_attacks.py``). What is certified is attacked as
well. The designs are those of today, or with ``--designs FILE`` those of a file.
"""

import argparse
import json
import subprocess
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import tarc
from benchmarks.design import OTHERS, ROBOTS, Robot
from reference.motion_attacks import Attacks, MotionAttacker
from tarc.analysis import InertiaSpread, Workspace
from tarc.analysis.linearise import decoupled_channels
from tarc.certificates import Certificate
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.certificates.robot_points import RobotPoints
from tarc.core.errors import DesignWarning, InfeasibleDesign, RobotFileWarning
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.plants.base import Plant
from tarc.signals import Chirp, Encoder, Payload, Reference, SineDisturbance, Sinusoid

PERIOD = 1e-3
SPEED = 1.0
"""Largest of each joint [rad/s], where the robot reaches it."""
SAMPLES = 500
CERTIFIED_STEPS = (0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Natural frequencies to certify, over the greatest that is stable for all constant ratios; better ones follow."""
BETTER_STEPS = (0.85, 0.9, 0.95)
ATTACKED_STEPS = (1.25, 1.5, 2.0, 3.0, 5.0, 10.0)
"""Natural frequencies to attack, over the greatest certified; 1.12 where the first breaks."""
RUN_TIME = 5.0
"""Of a nonlinear run [s]."""
MAX_ERROR = 0.02
"""Largest error in the last second of a nonlinear run that survives [rad]."""
FIRST_DESIGNS = Path(__file__).parent / "7266d86.json"
"""M̂, window and degree that the design tool chose at that revision, for the arms that it could load."""
RESULTS = Path(__file__).parents[1] / "runs" / "attacks.json"


ARMS = {robot.name: robot for robot in (*ROBOTS, *OTHERS)}
"""Those of the benchmark of designs."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """What a design fixes: M̂, window [periods], degree, and whether the estimation is synchronised."""

    inertia: list[list[float]]
    window: int
    degree: int
    synchronised: bool


@dataclass(frozen=True, kw_only=True)
class Result:
    """Of one arm and design; natural frequencies in rad/s.

    Attributes
    ----------
    frozen
        Greatest at which every constant ratio of the robot is stable.
    certified, route, margin
        Greatest that is certified, how, and its margin; zero for none.
    attacks, broken, growth
        Attacks on the certified loop, those that broke it, and the fastest growth [1/s].
    runs, failed
        Simulations of the nonlinear robot with the certified loop, and those that failed.
    unbroken, broken_at
        Greatest tried that no attack broke, and least that one did.
    revision
        Of the package.
    """

    name: str
    designs: str
    frozen: float
    certified: float
    route: str
    margin: float
    attacks: int
    broken: int
    growth: float
    runs: int
    failed: int
    unbroken: float
    broken_at: float
    revision: str

    @property
    def share(self) -> float:
        """Certified over the least that is broken: at least this much of what no attack breaks."""
        return self.certified / self.broken_at


class Case:
    """The loops of one arm with the M̂, window and degree of a design, over the natural frequency."""

    def __init__(self, arm: Robot, shape: Shape | None):
        self.plants = plants_of(arm)
        plant = self.plants[0]
        self.workspace = Workspace.from_joint_limits(plant).with_speed_limits(np.minimum(plant.velocity_limits, SPEED))
        self.shape = shape or shape_of(arm, plant)

    def law(self, natural_frequency: float) -> TDC:
        """Return the law without an adaptive gain."""
        return TDC(
            inertia=np.array(self.shape.inertia),
            natural_frequency=natural_frequency,
            period=PERIOD,
            estimator=Algebraic(window=self.shape.window * PERIOD, degree=self.shape.degree),
            synchronised=self.shape.synchronised,
        )

    @cached_property
    def points(self) -> RobotPoints:
        """Return what is known of the robot; each certificate adds the worst points that it finds."""
        return RobotPoints.from_robot(self.plants, np.array(self.shape.inertia), self.workspace, samples=SAMPLES)

    @property
    def spread(self) -> InertiaSpread:
        """Return the inertia ratios of the robot."""
        return self.points.spread

    def frozen_limit(self) -> float:
        """Return the greatest natural frequency up to which every constant ratio is stable."""
        ratios = np.geomspace(self.spread.min_ratio, self.spread.max_ratio, 25)
        last = 0.0
        for natural_frequency in np.geomspace(1.0, 600.0, 220):
            loop = decoupled_channels(self.law(float(natural_frequency)))[0]
            radii = [np.max(np.abs(np.linalg.eigvals(loop.state_matrix(float(ratio))))) for ratio in ratios]
            if max(radii) < 1:
                last = float(natural_frequency)
            elif last:
                break
        return last

    def certificate(self, natural_frequency: float) -> Certificate[Any]:
        """Return the best certificate of the robot."""
        law = self.law(natural_frequency)
        certificate = certify_robot(law, self.plants, self.workspace, samples=SAMPLES, points=self.points)
        return strengthen_robot(certificate, law, self.plants, self.workspace, samples=SAMPLES, points=self.points)

    def attack(self, natural_frequency: float, count: int, *, until_broken: bool = False) -> Attacks:
        """Attack the loop; the postures of the extreme ratios come first."""
        law = self.law(natural_frequency)
        starts = [np.asarray(posture) for posture in (self.spread.min_posture, self.spread.max_posture)]
        attacker = MotionAttacker(decoupled_channels(law)[0], law.M, self.plants, self.workspace, starts)
        return attacker.attack(count, until_broken=until_broken)

    def run(self, natural_frequency: float, count: int) -> int:
        """Simulate nonlinear runs with random motions, chirps, torques, and loads that come and go; return failures."""
        rng = np.random.default_rng(1)
        law = replace(self.law(natural_frequency), torque_limit=np.inf)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DesignWarning)  # a loop that is unstable at rest is what it looks for
            return sum(not self._survives(law, rng) for _ in range(count))

    def _survives(self, law: TDC, rng: np.random.Generator) -> bool:
        speed, acceleration = self.workspace.speed, self.workspace.acceleration
        assert speed is not None
        assert acceleration is not None
        n, (low, high) = len(speed), (self.workspace.low, self.workspace.high)
        slow = rng.uniform(0.5, 4.0, n)
        fast = slow if rng.random() < 0.5 else np.full(n, rng.uniform(2.0, 40.0))
        amplitude = np.minimum.reduce([speed / fast, acceleration / fast**2, 0.49 * (high - low)])
        offset = rng.uniform(low + amplitude, high - amplitude)
        reference: Reference = Sinusoid(amplitude=amplitude, frequency=fast, offset=offset)
        if fast is not slow:
            reference = Chirp(
                amplitude=amplitude, start_frequency=0.5, stop_frequency=float(fast[0]), sweep_time=4.0, offset=offset
            )
        start, stop = np.sort(rng.uniform(0.5, RUN_TIME - 1.0, 2))
        size = 0.01 * rng.random() * np.diag(law.M)
        frequency = float(np.exp(rng.uniform(np.log(1.0), np.log(300.0))))
        load = float(self.plants[1].parameters["payload"])
        run = tarc.simulate(
            self.plants[0],
            law,
            reference,
            RUN_TIME,
            sensor=Encoder(bits=17),
            disturbance=[
                Payload(mass=load, start_time=float(start), stop_time=float(stop)),
                SineDisturbance(amplitude=size, frequency=frequency),
            ],
            initial_torque="rest",
            native=True,
            progress=False,
        )
        errors = run.data["reference"].values - run.data["position"].values
        return bool(run.status.completed and np.abs(errors[-1000:]).max() < MAX_ERROR)


def plants_of(arm: Robot) -> list[Plant]:
    """Return the arm without and with its rated load."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)  # passive fingers and meshes
        plant = arm.plant()
    return [plant, plant.with_parameters({"payload": arm.payload})]


def shape_of(arm: Robot, plant: Plant) -> Shape:
    """Return what a design of today chooses, at the greatest of some speeds at which there is one."""
    for speed in (SPEED, SPEED / 2, SPEED / 4):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DesignWarning)
                made = tarc.design.design_controller(
                    plant,
                    payload=(0.0, arm.payload),
                    speed=np.minimum(plant.velocity_limits, speed),
                    samples=SAMPLES,
                    progress=False,
                )
        except InfeasibleDesign:
            continue
        law, estimator = made.law, made.estimator
        return Shape(
            inertia=np.asarray(law.M).tolist(),
            window=estimator.samples - 1,
            degree=estimator.degree,
            synchronised=law.synchronised,
        )
    raise InfeasibleDesign(f"no design at {SPEED / 4:g} rad/s")


def measure(
    name: str, shape: Shape | None, designs: str, count: int, on_certified: int, runs: int, say: Callable[[str], object]
) -> Result:
    """Certify, attack what is certified, and look for the greatest natural frequency that attacks leave."""
    case = Case(ARMS[name], shape)
    say(f"{name}: window {case.shape.window}, degree {case.shape.degree}, synchronised {case.shape.synchronised}")
    frozen = case.frozen_limit()
    spread = case.spread.max_ratio / case.spread.min_ratio
    say(f"{name}: constant ratios are stable up to {frozen:.3g} rad/s, spread {spread:.3g}")
    certified, best = 0.0, None
    for share in CERTIFIED_STEPS:
        certificate = case.certificate(share * frozen)
        say(f"{name}: at {share * frozen:.3g} rad/s {certificate.verdict}, margin {certificate.margin:.3g}")
        if certificate.certified:
            certified, best = share * frozen, certificate
            break
    if certified == CERTIFIED_STEPS[0] * frozen:
        for share in BETTER_STEPS:
            certificate = case.certificate(share * frozen)
            say(f"{name}: at {share * frozen:.3g} rad/s {certificate.verdict}, margin {certificate.margin:.3g}")
            if not certificate.certified:
                break
            certified, best = share * frozen, certificate
    own = case.attack(certified, on_certified) if certified else Attacks()
    say(f"{name}: {own.broken} of {own.count} attacks broke {certified:.3g} rad/s; growth {own.growth:.3g} 1/s")
    failed = case.run(certified, runs) if certified else 0
    say(f"{name}: {failed} of {runs} nonlinear runs failed")
    unbroken, broken_at = certified, np.inf
    for step in ATTACKED_STEPS if certified else ():
        tried = step * certified
        if tried >= frozen:
            broken_at = min(broken_at, frozen)  # a posture alone breaks it
            break
        if case.attack(tried, count, until_broken=True).broken:
            broken_at = tried
            break
        unbroken = tried
        say(f"{name}: {count} attacks did not break {tried:.3g} rad/s")
    say(f"{name}: broken at {broken_at:.3g} rad/s")
    route = "none" if best is None else "affine" if best.evidence.affine is not None else "ball"
    margin = 0.0 if best is None else best.margin
    return Result(
        name=name,
        designs=designs,
        frozen=frozen,
        certified=certified,
        route=route,
        margin=margin,
        attacks=own.count,
        broken=own.broken,
        growth=own.growth,
        runs=runs if certified else 0,
        failed=failed,
        unbroken=unbroken,
        broken_at=broken_at,
        revision=revision(),
    )


def revision() -> str:
    """Return the revision of the package, with a + for changes that are not committed."""
    command = ["git", "describe", "--always", "--dirty=+"]
    return subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True).stdout.strip()


def known_results(path: Path) -> list[Result]:
    """Return the results that a file holds."""
    return [Result(**row) for row in json.loads(path.read_text(encoding="utf-8"))] if path.is_file() else []


def main() -> None:
    """Measure the robots that are not in the file of results, add them, and print all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.attacks", description=__doc__)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=f"some of {', '.join(ARMS)}; default all")
    parser.add_argument("--designs", type=Path, help="JSON with M̂, window and degree by name; default: today's designs")
    parser.add_argument("--attacks", type=int, default=1000, help="on each loop beyond the certified one")
    parser.add_argument("--on-certified", type=int, default=7000, help="attacks on each certified loop")
    parser.add_argument("--runs", type=int, default=200, help="nonlinear runs of each certified loop")
    parser.add_argument("--out", type=Path, default=RESULTS, help="file of results")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    console, start = Console(width=None if Console().is_terminal else 150), time.monotonic()
    shapes: dict[str, Shape] = {}
    label = "today"
    if options.designs:
        label = options.designs.stem
        rows = json.loads(options.designs.read_text(encoding="utf-8"))
        shapes = {name: Shape(**row) for name, row in rows.items()}
    found = known_results(options.out)
    for name in options.robots or ARMS:
        if (options.designs and name not in shapes) or any((one.name, one.designs) == (name, label) for one in found):
            continue

        def say(text: str) -> None:
            console.print(f"[dim]{time.monotonic() - start:6.0f} s {text}[/dim]", highlight=False)

        try:
            found.append(
                measure(name, shapes.get(name), label, options.attacks, options.on_certified, options.runs, say)
            )
        except InfeasibleDesign as error:
            say(f"{name}: {error}")
            continue
        options.out.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n", encoding="utf-8")
    console.print(table_of(found))


def table_of(found: Sequence[Result]) -> Table:
    """Return the results as a table."""
    heads = ("arm", "designs", "certified", "by", "margin", "broken", "failed runs", "not broken", "broken at", "share")
    table = Table(*heads, title="Greatest natural frequencies [rad/s]", title_justify="left")
    for one in found:
        table.add_row(
            one.name,
            one.designs,
            f"{one.certified:.3g}",
            one.route,
            f"{one.margin:.2g}",
            f"{one.broken} of {one.attacks}",
            f"{one.failed} of {one.runs}",
            f"{one.unbroken:.3g}",
            f"{one.broken_at:.3g}",
            f"{one.share:.2f}",
        )
    return table


if __name__ == "__main__":
    main()
