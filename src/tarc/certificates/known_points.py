"""Where a robot is worst for a law with M̂(q), from samples and local search."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tarc.analysis.inertia_rate import max_rate_point
from tarc.analysis.known_inertia import KnownInertia, lagged_force_norms, worst_points
from tarc.analysis.operating_points import OperatingPoint, UncertaintySamples
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import sample_points
from tarc.certificates.known_ball import KnownBall
from tarc.certificates.known_forces import force_bounds
from tarc.certificates.known_inertia_evidence import KnownPoint, KnownRatePoint
from tarc.certificates.robot_evidence import LinearisedPoint, MaxRatePoint
from tarc.core.types import Array
from tarc.laws.nominal_inertia import NominalInertia
from tarc.plants.base import Plant


class WorstKnownPoints(NamedTuple):
    """Where a robot is worst for M̂(q) of a model, whatever its fraction ρ.

    H, C and the rate of M̂ do not depend on ρ, and E is proportional to it.

    Attributes
    ----------
    fraction
        ρ of the law for which they were found.
    points
        Operating points.
    rate_point
        Where M̂(q) changes fastest.
    relative_rate_point
        Where M changes fastest relative to itself.
    """

    fraction: float
    points: list[OperatingPoint]
    rate_point: KnownRatePoint
    relative_rate_point: MaxRatePoint

    @classmethod
    def search(
        cls, inertia: NominalInertia, plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int
    ) -> "WorstKnownPoints":
        """Search a workspace with speeds, from samples."""
        known = KnownInertia(inertia)
        return cls(
            inertia.fraction,
            _operating_points(known, plants, workspace, samples, seed),
            _rate_point(known, plants, workspace, samples, seed),
            _relative_rate_point(plants, workspace, samples, seed),
        )

    def with_fraction(self, fraction: float) -> "WorstKnownPoints":
        """Return the same for another fraction."""
        factor, rate = fraction / self.fraction, self.rate_point
        scaled = replace(rate, nominal=factor * rate.nominal, inertia_slopes=factor * rate.inertia_slopes)
        return self._replace(fraction=fraction, rate_point=scaled)


def _relative_rate_point(plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int) -> MaxRatePoint:
    """Return where the robot's M changes fastest relative to itself."""
    return MaxRatePoint.from_point(max_rate_point(plants, None, workspace, samples, seed), workspace)


def _rate_point(
    known: KnownInertia, plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int
) -> KnownRatePoint:
    """Return where M̂(q) changes fastest."""
    speed = np.asarray(workspace.speed)
    resting = [OperatingPoint.at_rest(plants[0], posture) for posture in workspace.sample(samples, seed)]

    def rates(points: Sequence[OperatingPoint]) -> Array:
        return known.rates(points, speed)

    found = worst_points(resting, rates, workspace, workspace.unit_samples(samples, seed))
    worst = found[int(np.argmax(rates(found)))]
    slopes = known.inertia.fraction * known.inertia.robot.inertia_slopes(worst.position)
    return KnownRatePoint(nominal=known.inertias([worst])[0], inertia_slopes=slopes, velocity_limits=speed)


def _operating_points(
    known: KnownInertia, plants: Sequence[Plant], workspace: Workspace, samples: int, seed: int
) -> list[OperatingPoint]:
    """Return sampled points, with those of the smallest and largest ratio and of the largest stiffness before them."""
    points = sample_points(plants, workspace, samples, seed)
    resting = [point for point in points if not point.is_moving]
    units = workspace.unit_samples(samples, seed)
    sampled = known.uncertainty(points)
    is_resting = np.array([not point.is_moving for point in points])
    ratios = np.linalg.eigvalsh(sampled.inertia[is_resting])
    smallest = worst_points(resting, lambda some: -_ratios(known, some)[:, 0], workspace, units, -ratios[:, 0])
    largest = worst_points(resting, lambda some: _ratios(known, some)[:, -1], workspace, units, ratios[:, -1])
    lead_time = sampled.lead_time()
    stiffest = worst_points(
        points,
        lambda some: known.uncertainty(some).stiffness_norms(lead_time),
        workspace,
        units,
        sampled.stiffness_norms(lead_time),
    )
    force_lead_time = sampled.force_lead_time()
    forced = worst_points(
        points,
        lambda some: known.uncertainty(some).force_norms(force_lead_time),
        workspace,
        units,
        sampled.force_norms(force_lead_time),
    )
    return [*smallest, *largest, *stiffest, *forced, *points]


def worst_for_ball(
    ball_and_period: tuple[KnownBall, float],
    known: KnownInertia,
    points: list[OperatingPoint],
    workspace: Workspace,
    units: Array,
) -> list[OperatingPoint]:
    """Return the points of the largest joint norm for a ball."""
    ball, period = ball_and_period
    lead_time = ball.loop.lead_periods.item() * period

    def norms(some: Sequence[OperatingPoint]) -> Array:
        return known.uncertainty(some).joint_norms(ball.centre, ball.position_weight, lead_time)

    return worst_points(points, norms, workspace, units)


def _ratios(known: KnownInertia, points: Sequence[OperatingPoint]) -> Array:
    """Return the eigenvalues of M⁻¹M̂ at k points, ascending, shape (k, n)."""
    return np.linalg.eigvalsh(known.uncertainty(points).inertia)


def stored_points(
    known: KnownInertia,
    points: Sequence[OperatingPoint],
    uncertainty: UncertaintySamples,
    ball: KnownBall,
    periods: tuple[float, int],
) -> list[KnownPoint]:
    """Return the points of the extreme ratios, of the largest stiffness, norm and forces, for a period and a delay."""
    lead_time = ball.loop.lead_periods.item() * periods[0]
    ratios = np.linalg.eigvalsh(uncertainty.inertia)
    stiffness = uncertainty.stiffness_norms(lead_time)
    chosen = [int(np.argmin(ratios[:, 0])), int(np.argmax(ratios[:, -1])), int(np.argmax(stiffness))]
    if ball.position_weight:
        norms = uncertainty.joint_norms(ball.centre, ball.position_weight, lead_time)
        chosen.append(int(np.argmax(norms)))
    nominal, (M, D, G, own) = known.inertias(points), known.linearised_apart(points)
    parts = nominal, M, D, G - own, own
    for power, lead, lag in force_bounds(uncertainty, *periods):
        chosen.append(int(np.argmax(lagged_force_norms(parts, lead, power, lag))))
    indices = list(dict.fromkeys(chosen))
    worst = [points[i] for i in indices]
    nominal, M, D, G, own = (part[indices] for part in (nominal, M, D, G, own))
    return [
        KnownPoint(
            nominal=nominal[i],
            robot=LinearisedPoint(
                position=point.position,
                inertia=M[i],
                damping=D[i],
                stiffness=G[i] - own[i],
                velocity=point.velocity if point.is_moving else None,
                acceleration=point.acceleration if point.is_moving else None,
            ),
            model_stiffness=own[i],
        )
        for i, point in enumerate(worst)
    ]
