"""How long the proof of a whole workspace takes: ``python -m benchmarks.workspace_proof [--time SECONDS] [NAME …]``.

Each robot has a design by the least spread of its inertia ratios, certified by a ball or an affine Lyapunov function,
for all that its joints reach at 1 rad/s, empty and loaded. Its bounds are then proven by branch and bound. What is
left after the time is printed, and with --keep the next run goes on from there. Times are those of the processor.
For six joints, stiffness and damping are bounded by groups, and "all forces" says how much larger their sum is than the
forces found.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from typing import NamedTuple

from rich.console import Console

from tarc.analysis import Workspace, best_inertia_shape, inertia_spread
from tarc.certificates import ProvenRobot, certify_robot, prove_robot, strengthen_robot
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.plants import NLinkArm, TwoLinkArm, load_robot
from tarc.plants.base import Plant

PERIOD = 1e-3
SPEED = 1.0


class Design(NamedTuple):
    """Natural frequency [rad/s], window [periods], greatest inertia ratio, and largest payload [kg]."""

    natural_frequency: float
    window: int
    max_ratio: float
    payload: float


DESIGNS = {
    "two_link": Design(30.0, 6, 0.8, 2.0),
    "three_link": Design(15.0, 6, 0.8, 1.0),
    "ur5e": Design(28.0, 6, 1.1, 5.0),
    "panda": Design(24.0, 5, 1.2, 3.0),
}


def plants_of(name: str) -> list[Plant]:
    """Return a robot without and with its payload."""
    payloads = 0.0, DESIGNS[name].payload
    if name == "two_link":
        return [TwoLinkArm(payload=payload) for payload in payloads]
    if name == "three_link":
        return [NLinkArm(payload=payload) for payload in payloads]
    return [load_robot(name, armature=0.1, payload=payload) for payload in payloads]


def prove(name: str, seconds: float, samples: int = 500) -> tuple[ProvenRobot, float]:
    """Return the proof of a robot's certificate within a time, and the time of the processor [s]."""
    plants, design = plants_of(name), DESIGNS[name]
    workspace = Workspace.from_joint_limits(plants[0], speed=SPEED)
    shape, _ = best_inertia_shape(plants, workspace, samples=samples)
    scale = design.max_ratio / inertia_spread(plants, shape, workspace, samples=samples).max_ratio
    law = TDC(
        inertia=scale * shape,
        natural_frequency=design.natural_frequency,
        period=PERIOD,
        estimator=Algebraic(window=design.window * PERIOD, degree=3),
        synchronised=True,
    )
    certificate = certify_robot(law, plants, workspace, samples=samples)
    certificate = strengthen_robot(certificate, law, plants, workspace, samples=samples)
    start = time.process_time()
    return prove_robot(certificate, law, plants, workspace, time_limit=seconds), time.process_time() - start


def main(arguments: Sequence[str] | None = None) -> None:
    """Prove the designs in turn, and print the bounds with their proven shares."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.workspace_proof", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(DESIGNS)}")
    parser.add_argument("--time", type=float, default=600.0, metavar="SECONDS", help="for each robot, by the clock")
    parser.add_argument("--keep", action="store_true", help="go on from, and keep, what earlier runs have proven")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(DESIGNS):
        parser.error(f"no robot {', '.join(sorted(unknown))}; there are {', '.join(DESIGNS)}")
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        if not options.keep:
            os.environ["XDG_CACHE_HOME"] = folder
        for name in options.names or list(DESIGNS):
            proven, seconds = prove(name, options.time)
            console.print(f"{name}: {proven.certificate.verdict_in_words}; {seconds:.1f} s", highlight=False)
            for part in proven.parts:
                console.print(f"  {part}; {part.n_boxes} boxes", highlight=False, markup=False)


if __name__ == "__main__":
    main()
