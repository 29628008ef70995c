"""What each part of an arm's certificate costs: ``python -m benchmarks.certificate_losses [ROBOT …]``.

For arms with their rated load at 1 rad/s, at the M̂, window and degree of today's designs. The natural frequency is
raised until no Lyapunov function is found, with parts of what it must cover left out. It counts relative to the
greatest natural frequency at which every constant inertia ratio of the robot is stable.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from benchmarks.attacks import ARMS, Case
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import SEARCH_MARGIN, UncertaintySamples
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates.affine import find_proof
from tarc.certificates.affine_cover import robot_ratios
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.force_form import ForcePoints

NAMES = "Panda", "xArm7"
"""Arms that are measured by default."""
LOWEST, TOLERANCE = 0.68, 0.03
"""Least share that is looked for, and how exactly."""
MIN_RATE = 1e-3
"""Rate of the inertia that stands for none [1/s]."""


class Loss(NamedTuple):
    """What was left out, and the greatest certified natural frequency over that of constant ratios."""

    left_out: str
    share: float


def losses(name: str) -> Iterator[Loss]:
    """Yield the shares of an arm; the last one knows the power of stiffness and damping."""
    case = Case(ARMS[name], None)
    points, frozen, room = case.points, case.frozen_limit(), 1 + SEARCH_MARGIN
    rate_points = points.max_rate_point(), points.max_relative_rate_point()
    found = tuple(point for point in rate_points if point is not None)
    ratios, _, sampled = robot_ratios(points.spread, points.sampled, found, 1e-3)
    unrubbed = replace(sampled, uncertainty=_without_friction(sampled.uncertainty))
    smooth, *_ = robot_ratios(points.spread, unrubbed, found, 1e-3)
    exact = replace(
        ratios,
        min_ratio=ratios.min_ratio * room,
        max_ratio=ratios.max_ratio / room,
        rate=ratios.rate / room,
        relative_rate=ratios.relative_rate / room,
        stiffness=ratios.stiffness / room,
    )
    still = replace(ratios, rate=MIN_RATE, relative_rate=MIN_RATE * ratios.max_ratio)
    free = ratios.without_norms()

    def greatest(covered: RatioSet, forces: ForcePoints | None = None) -> float:
        low, high = LOWEST, 1.0
        while high - low > TOLERANCE:
            middle = (low + high) / 2
            channel = decoupled_channels(case.law(middle * frozen))[0]
            loop = UncertainLoop.from_channel(channel, 0.0, intersample=True)
            low, high = (middle, high) if find_proof(loop, covered, forces=forces) else (low, middle)
        return low

    yield Loss("nothing", greatest(ratios))
    yield Loss(f"the margin of {100 * SEARCH_MARGIN:.0f} %", greatest(exact))
    yield Loss("viscous friction", greatest(smooth))
    yield Loss("rates of the inertia", greatest(still))
    yield Loss("stiffness and damping", greatest(free))
    power = ForcePoints(sampled.uncertainty.with_friction(), SEARCH_MARGIN)
    yield Loss("nothing, with the form that knows their power", greatest(free, power))


def _without_friction(samples: UncertaintySamples) -> UncertaintySamples:
    return UncertaintySamples(samples.inertia, samples.stiffness, samples.damping)


def main() -> None:
    """Print the shares of arms."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.certificate_losses", description=__doc__)
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help=f"some of {', '.join(ARMS)}; default {NAMES}")
    table = Table("arm", "left out of the certificate", "certified / constant ratios", title_justify="left")
    for name in parser.parse_args().robots or NAMES:
        for loss in losses(name):
            table.add_row(name, loss.left_out, f"{loss.share:.2f}")
    Console(width=None if Console().is_terminal else 120).print(table)


if __name__ == "__main__":
    main()
