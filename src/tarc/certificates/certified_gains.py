"""Gains that may change while a law runs, each with the values for which the law is certified."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.linearise import require_inertia
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Verdict
from tarc.certificates.known_inertia import certify_known_inertia, check_known_robot
from tarc.certificates.known_inertia_evidence import KnownInertiaEvidence
from tarc.certificates.known_points import WorstKnownPoints
from tarc.certificates.robot import certify_robot
from tarc.certificates.robot_evidence import RobotEvidence
from tarc.certificates.robot_points import RobotPoints
from tarc.core.errors import InvalidParameter
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.plants.base import Plant

FREQUENCY_STEP = 1.1
"""Ratio of a natural frequency that is tried to the one before."""
MAX_FACTOR = 2.0
"""Largest ratio of a natural frequency that is tried to that of the law, in both directions."""
SLOPE_FACTOR = 2.0
"""Ratio of the slopes of the robust term between which the largest certified one is searched."""
SLOPE_TOLERANCE = 1.05
"""Ratio of the ends of the interval at which that search ends."""
SIGNIFICANT_DIGITS = 3
"""Of a natural frequency that is tried."""
EQUAL = 1e-9
"""Relative distance at which two natural frequencies are the same."""

AnyCertificate = Certificate[RobotEvidence] | Certificate[KnownInertiaEvidence]


@dataclass(frozen=True)
class GainRange:
    """Certified values of a gain, all others as they are.

    Attributes
    ----------
    name
        Parameter of the law.
    low, high
        Ends of the range; infinity for a gain that may have any value above zero.
    values
        Where each value has a certificate of its own, all of them in order; empty where every value between the ends
        is covered.
    """

    name: str
    low: float
    high: float
    values: tuple[float, ...] = ()

    def nearest(self, value: float) -> float:
        """Return the nearest certified value."""
        if self.values:
            return min(self.values, key=lambda certified: abs(certified - value))
        return min(max(value, self.low), self.high)

    def contains(self, value: float) -> bool:
        """Return whether a value is certified."""
        if self.values:
            return any(abs(value - certified) <= EQUAL * certified for certified in self.values)
        return self.low <= value <= self.high

    def __str__(self) -> str:
        if self.values:
            return f"one of {', '.join(f'{value:g}' for value in self.values)}"
        return "any above 0" if np.isinf(self.high) else f"{self.low:.4g} to {self.high:.4g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class CertifiedGains:
    """Gains with which a law is certified on a robot, as `certify_gains` finds them.

    Each natural frequency has a certificate of its own. It covers every slope of the robust term up to a largest one,
    and lets the slope change at any time. So it covers ``max_gain`` and the rates of TARC. Changes of the natural
    frequency are covered by no certificate: each starts a loop that is certified.

    Attributes
    ----------
    law
        The law from which the search started.
    slopes
        Largest certified slope of the robust term [1/s²] by natural frequency [rad/s]; empty where the law itself is
        not certified.
    certificate
        That of the law itself.
    """

    law: PolePlacement
    slopes: Mapping[float, float]
    certificate: AnyCertificate

    @property
    def reason(self) -> str:
        """Return why no gain may change; empty where one may."""
        if self.slopes:
            return ""
        return f"the law is {self.certificate.verdict} on this robot, so that no gain of it may change while it runs"

    def ranges(self, law: PolePlacement | None = None) -> dict[str, GainRange]:
        """Return the certified range of each gain, all others as in a law; None for the law itself."""
        present = self.law if law is None else law
        slope, limit = present.robust_slope_bound, self._limit(present)
        if limit is None:
            return {}
        frequencies = tuple(value for value, largest in sorted(self.slopes.items()) if slope <= largest * (1 + EQUAL))
        ranges = {"natural_frequency": GainRange("natural_frequency", frequencies[0], frequencies[-1], frequencies)}
        if isinstance(present, TARC) and present.max_gain is not None:
            ranges["max_gain"] = GainRange("max_gain", present.start_gain, present.max_gain * limit / slope)
            ranges |= {name: GainRange(name, 0.0, np.inf) for name in ("rise_rate", "fall_rate")}
        return ranges

    def change(self, law: PolePlacement, gains: Mapping[str, float]) -> PolePlacement:
        """Return a law with other gains.

        Between two steps a gain of TARC may still be that of the law before. So the new natural frequency must be
        certified for the larger of both slopes.

        Raises
        ------
        InvalidParameter
            For gains outside their range, and for parameters that have none.
        """
        if self.reason:
            raise InvalidParameter(f"gains: {self.reason}; change the design until it is certified", "gains")
        ranges = self.ranges(law)
        for name in gains:
            if name not in ranges:
                raise InvalidParameter(
                    f"{name}: it has no certified range, so it cannot change while the law runs; those that can are "
                    f"{', '.join(ranges)}. Stop, and certify another law",
                    name,
                )
        changed: dict[str, Any] = {name: float(value) for name, value in gains.items()}
        for name, value in changed.items():
            if not ranges[name].contains(value):
                raise InvalidParameter(
                    f"{name}: got {value:g}; certified with the other gains as they are: {ranges[name]}. Give such a "
                    "value, or stop and certify another law",
                    name,
                )
        result = replace(law, **changed)
        limit = self._limit(result)
        if limit is None or _first_slope(law, result) > limit * (1 + EQUAL):
            raise InvalidParameter(
                f"{', '.join(changed)}: certified one at a time, but not together; change one after the other", "gains"
            )
        return result

    def _limit(self, law: PolePlacement) -> float | None:
        """Return the largest certified slope at a law's natural frequency; None for none."""
        value = float(np.sqrt(law.K1[0, 0]))
        return next((slope for other, slope in self.slopes.items() if abs(value - other) <= EQUAL * other), None)


def certify_gains(
    law: PolePlacement,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
    on_certificate: Callable[[int, int], object] = lambda count, most: None,
) -> CertifiedGains:
    """Search the gains with which a law stays certified on a robot, so that they may change while it runs.

    Natural frequencies are certified one by one, in steps of 10 %, down and up from that of the law. The search stops
    at the first that is not certified, and at half and twice the law's. For TARC the largest slope α ĉ ‖P2‖/ε of the
    robust term is searched at the law's own natural frequency, to 5 %. With M̂(q) of a model each certificate is that
    of `certify_known_inertia` with ``quick``: a ball, whose loop has the slope anywhere between zero and the largest.

    Parameters
    ----------
    law
        A law with an inertia, constant or M̂(q), and one natural frequency for all joints.
    plant, workspace, computation_delay, samples, seed
        As in `tarc.certify_law`.
    on_certificate
        Called with the number of certificates that were made, and the most that there may be, to show progress.

    Returns
    -------
    CertifiedGains
        Without gains where the law itself is not certified.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for M̂(q) in a workspace without speeds.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For natural frequencies that differ, or gains K1 and K2 in their place.
    """
    law = require_inertia(law, "certify_gains")
    frequencies = np.unique(np.ravel(np.inf if law.natural_frequency is None else law.natural_frequency))
    if len(frequencies) != 1 or not np.isfinite(frequencies[0]):
        raise InvalidParameter(
            f"natural_frequency: got {law.natural_frequency!r}; needs one number for all joints", "natural_frequency"
        )
    certify_law = _certifier(law, as_plants(plant), workspace, computation_delay, samples, seed)
    n_steps = int(math.log(MAX_FACTOR) / math.log(FREQUENCY_STEP) + EQUAL)
    most = 1 + _n_slopes(law) + 2 * n_steps
    count = 0

    def certify(**gains: float) -> AnyCertificate:
        nonlocal count
        certificate = certify_law(**gains)
        count += 1
        on_certificate(count, most)
        return certificate

    own = float(frequencies[0])
    certificate = certify()
    slopes: dict[float, float] = {}
    if certificate.verdict == Verdict.CERTIFIED:
        slopes[own] = _largest_slope(law, certify)
        for step in (1 / FREQUENCY_STEP, FREQUENCY_STEP):
            for number in range(1, n_steps + 1):
                rounded = float(f"{own * step**number:.{SIGNIFICANT_DIGITS}g}")
                if certify(natural_frequency=rounded).verdict != Verdict.CERTIFIED:
                    break
                slopes[rounded] = replace(law, natural_frequency=rounded).robust_slope_bound
    return CertifiedGains(law=law, slopes=slopes, certificate=certificate)


def _certifier(
    law: PolePlacement,
    plants: Sequence[Plant],
    workspace: Workspace,
    computation_delay: int,
    samples: int,
    seed: int,
) -> Callable[..., AnyCertificate]:
    """Return a function that certifies the law with other gains; what the robot is along its motions is found once."""
    if isinstance(law.inertia, NominalInertia):
        workspace = workspace.for_joints(plants[0].joint_names)
        check_known_robot(law, plants, workspace)
        worst = WorstKnownPoints.search(law.inertia, plants, workspace, samples, seed)
        return lambda **gains: certify_known_inertia(
            replace(law, **gains),
            plants,
            workspace,
            computation_delay=computation_delay,
            samples=samples,
            seed=seed,
            quick=True,
            worst=worst,
        )
    torque_law, plants = in_torque_units(law, plants)
    points = RobotPoints.from_robot(plants, torque_law.M, workspace, samples=samples, seed=seed)
    return lambda **gains: certify_robot(
        replace(torque_law, **gains),
        plants,
        workspace,
        computation_delay=computation_delay,
        samples=samples,
        seed=seed,
        points=points,
    )


def _first_slope(law: PolePlacement, changed: PolePlacement) -> float:
    """Return the bound on the slope of a changed law in its first step, whose gain is that of the law before."""
    if isinstance(law, TARC) and isinstance(changed, TARC) and law.max_gain is not None:
        return replace(changed, max_gain=max(law.max_gain, changed.max_gain or 0.0)).robust_slope_bound
    return changed.robust_slope_bound


def _n_slopes(law: PolePlacement) -> int:
    """Return the number of slopes of the robust term that are tried; each takes the root of the ratio of the ends."""
    if not isinstance(law, TARC) or law.max_gain is None:
        return 0
    return math.ceil(math.log2(math.log(SLOPE_FACTOR) / math.log(SLOPE_TOLERANCE)))


def _largest_slope(law: PolePlacement, certify: Callable[..., AnyCertificate]) -> float:
    """Return the largest slope of the robust term that is found certified at the law's natural frequency."""
    if not isinstance(law, TARC) or law.max_gain is None:
        return law.robust_slope_bound
    low, high = 1.0, SLOPE_FACTOR
    for _ in range(_n_slopes(law)):
        factor = (low * high) ** 0.5
        if certify(max_gain=factor * law.max_gain).verdict == Verdict.CERTIFIED:
            low = factor
        else:
            high = factor
    return low * law.robust_slope_bound
