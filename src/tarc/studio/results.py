"""What other processes compute for the page, as plain numbers; nothing here imports what computes."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from tarc.core.types import Array


@dataclass(frozen=True, eq=False)
class RobotFacts:
    """What the page needs of a robot and its motion.

    Attributes
    ----------
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̄ along the motion, where M̄ is the mean inertia.
    mean_inertia
        M̄ [kg m² or kg], shape (n, n).
    computation_delay
        Periods between a measurement and its torque.
    """

    min_ratio: float
    max_ratio: float
    mean_inertia: Array
    computation_delay: int = 0


@dataclass(frozen=True, eq=False)
class StabilityMap:
    """Stable inertia ratios over the natural frequency.

    Attributes
    ----------
    natural_frequencies
        [rad/s], shape (k,).
    low, high
        Ends of the widest stable range of ρ at each, shape (k,); nan for none.
    """

    natural_frequencies: Array
    low: Array
    high: Array

    def shares(self, facts: RobotFacts) -> tuple[Array, Array]:
        """Return the ends of the inertia share for which every constant ratio of the robot is stable; nan for none."""
        low, high = self.low / facts.min_ratio, self.high / facts.max_ratio
        is_empty = ~(low < high)
        return np.where(is_empty, np.nan, low), np.where(is_empty, np.nan, high)


@dataclass(frozen=True, eq=False)
class LoopAnalysis:
    """The loop of a design.

    Attributes
    ----------
    map
        Stability over the natural frequency.
    stable
        Widest stable range of ρ at the design; None for none.
    ratios
        Smallest, mean and largest ρ of the robot.
    is_stable
        Whether the loop is stable at each of them.
    torque_noise
        Largest RMS torque noise of a joint by the encoder at the mean ratio [N m or N]; infinite for an unstable loop.
    frequencies
        [rad/s], shape (m,).
    loop_gains
        |L| at the smallest, mean and largest ratio, shape (3, m).
    crossover
        Largest frequency at which |L| is one at the mean ratio [rad/s]; nan for none.
    error_over_optimum, change_over_optimum
        Error and torque change over those of the optimal linear controller, at the mean ratio, as
        `tarc.analysis.optimum.OptimumDistance` has them; infinite for an unstable loop.
    """

    map: StabilityMap
    stable: tuple[float, float] | None
    ratios: tuple[float, float, float]
    is_stable: tuple[bool, bool, bool]
    torque_noise: float
    frequencies: Array
    loop_gains: Array
    crossover: float
    error_over_optimum: float
    change_over_optimum: float


@dataclass(frozen=True, eq=False)
class Curves:
    """What the page draws of a run.

    Attributes
    ----------
    name
        Name of the law.
    joints
        Names of the joints.
    times
        [s], shape (k,).
    errors, torques
        Of each joint [rad or m], [N m or N], shape (k, n).
    gain
        Switching gain ĉ [rad/s²], shape (k,); None for a law without.
    measures
        Of the run, as `tarc.simulation.Run.metrics`; empty for one that diverged before.
    units, scales
        Units in which the page shows the measures, by name, and their factors from SI units.
    status, has_completed
        How the run ended, in words, and whether at its end.
    """

    name: str
    joints: tuple[str, ...]
    times: Array
    errors: Array
    torques: Array
    gain: Array | None
    measures: dict[str, float]
    units: dict[str, str]
    scales: dict[str, float]
    status: str
    has_completed: bool


@dataclass(frozen=True, eq=False)
class CurvePair:
    """The curves of a design and of its rival."""

    design: Curves
    rival: Curves

    @classmethod
    def named(cls, design: Curves, rival: Curves) -> Self:
        """Return the pair with the rival named as such."""
        return cls(design, replace(rival, name=f"{rival.name} (rival)"))


@dataclass(frozen=True)
class CertificateRow:
    """A certificate as the page shows it.

    Attributes
    ----------
    kind, label
        Name of the test, and what the page calls it.
    verdict
        ``certified``, ``refuted`` or ``inconclusive``.
    margin
        Its margin.
    reason
        Why, in one line.
    claim
        What it claims.
    """

    kind: str
    label: str
    verdict: str
    margin: float
    reason: str
    claim: str


@dataclass(frozen=True, eq=False)
class StudyStart:
    """What a study draws and measures.

    Attributes
    ----------
    content
        Of the study.
    labels
        What the page calls each drawn value, with its unit.
    units, scales
        Units in which the page shows the measures, by name, and their factors from SI units.
    """

    content: dict[str, Any]
    labels: dict[str, str]
    units: dict[str, str]
    scales: dict[str, float]


@dataclass(frozen=True, eq=False)
class StudyChunk:
    """Some finished runs of a study.

    Attributes
    ----------
    runs
        Their numbers, shape (k,).
    values
        Drawn values, shape (k, keys).
    measures
        Each of shape (k, 2): of the design and its rival; nan for a run without.
    completed
        Shape (k, 2).
    """

    runs: Array
    values: Array
    measures: dict[str, Array]
    completed: Array


@dataclass(frozen=True)
class LiveLog:
    """Where a loop writes its rows."""

    folder: str


@dataclass(frozen=True)
class LiveStage:
    """What the process does before the loop runs, in words."""

    text: str


@dataclass(frozen=True)
class LiveGain:
    """A gain that may change while the loop runs.

    Attributes
    ----------
    value
        The one that runs.
    low, high
        Ends of its certified range; infinity where there is no limit.
    values
        Where each value has a certificate of its own, all of them in order; empty for a range.
    text
        The range in words.
    """

    value: float
    low: float
    high: float
    values: tuple[float, ...]
    text: str


@dataclass(frozen=True)
class LiveGains:
    """Gains that may change now, by name; without any, why none may."""

    gains: dict[str, LiveGain]
    reason: str


@dataclass(frozen=True)
class LiveRefusal:
    """Why a change of gains was refused."""

    text: str


@dataclass(frozen=True)
class LiveEnd:
    """How a run on a robot ended.

    Attributes
    ----------
    text
        Why, with missed periods.
    is_safe_stop
        Whether it ended in a safe stop.
    """

    text: str
    is_safe_stop: bool
