"""A small push of each joint before the start: its sign and its torque constant."""

from dataclasses import asdict, dataclass

import numpy as np

from tarc.analysis.stability import stable_intervals
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.core.types import Array
from tarc.core.validation import Matrix
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia

MIN_CERTAINTY = 4.0
"""Least ratio of a measured response to its standard error."""
MIN_SAMPLES = 8
"""Least number of positions that show anything."""
MAX_FRICTION = 0.4
"""Largest share of the push that dry friction may be."""
FRICTIONS = 40
"""Frictions that are tried."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Push(Component):
    """A pulse of torque on one joint at a time, on top of the holding torque, with the law switched off.

    The torque is +p for a time d, −p for 2d and +p for d. It leaves neither velocity nor displacement on a free joint.

    Parameters
    ----------
    share
        p, as a share of the joint's torque limit.
    time
        d [s].
    max_travel
        Largest distance that any joint may move meanwhile [rad or m]; beyond it the run ends in a safe stop.
    inertia
        M(q) of the robot at the start, where a model is known [kg m² or kg], as for a law. The torque constant is then
        known beside the inertia ratio.
    tolerance
        Factor by which a torque constant may be off, downward and upward.
    """

    share: float = 0.2
    time: float = 0.01
    max_travel: float = 0.05
    inertia: Matrix | None = None
    tolerance: float = 2.0

    def __post_init__(self) -> None:
        check.number("share", self.share, 0, strict=True, high=1.0)
        check.number("time", self.time, 0, strict=True)
        check.number("max_travel", self.max_travel, 0, strict=True)
        check.number("tolerance", self.tolerance, 1)

    def profile(self, period: float) -> Array:
        """Return the sign of the torque in each period, with as much rest after it."""
        periods = max(1, round(self.time / period))
        return np.repeat([1.0, -1.0, -1.0, 1.0, 0.0], periods)


@dataclass(frozen=True)
class PushResponse:
    """What a push of one joint showed.

    Attributes
    ----------
    joint
        Number of the joint, from 0.
    mobility
        Acceleration per torque of the free joint, (M⁻¹)_ii κ, with the error κ of the torque constant.
    certainty
        Ratio of it to its standard error.
    friction
        Dry friction [N m or N].
    ratio
        mobility · M̂_ii, the inertia ratio that the law meets at this joint; NaN for a law without a constant M̂.
    stable
        Inertia ratios for which the law's loop is stable, as intervals; empty where unknown.
    torque_constant
        κ, the torque on the joint per torque that was written, at least and at most. It is μ / (M⁻¹)_ii where all
        other joints move freely, and μ M_ii where friction holds them. NaN without a model of the inertia.
    allowed_factor
        Factor by which κ may be off.
    push
        Largest torque of the push [N m or N].
    """

    joint: int
    mobility: float
    certainty: float
    friction: float
    ratio: float
    stable: tuple[tuple[float, float], ...]
    torque_constant: tuple[float, float] = (np.nan, np.nan)
    allowed_factor: float = np.inf
    push: float = np.nan

    @property
    def fault(self) -> str:
        """Return what is wrong, in words; empty where nothing is."""
        if not abs(self.certainty) >= MIN_CERTAINTY:
            return "did not move with the push: stuck, not connected, or its friction is above the push"
        if self.friction > MAX_FRICTION * self.push:
            return f"has a dry friction close to the push, {self.friction:.3g} of {self.push:.3g}: push more"
        if self.mobility < 0:
            return "moved against the push: its torque or its encoder has the wrong sign"
        if self.stable and np.isfinite(self.ratio) and not any(low < self.ratio < high for low, high in self.stable):
            text = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in self.stable)
            return f"has an inertia ratio of {self.ratio:.3g}, and the law is stable for {text} alone"
        least, most = self.torque_constant
        if self.allowed_factor * most < 1 or least > self.allowed_factor:
            return f"has {least:.2f} to {most:.2f} times the torque that was written, by the model of its inertia"
        return ""

    @property
    def tolerance(self) -> tuple[float, float]:
        """Return the factors by which the torque may still change before the law's loop is unstable."""
        for low, high in self.stable:
            if low < self.ratio < high:
                return low / self.ratio, high / self.ratio
        return np.nan, np.nan

    def to_dict(self) -> dict[str, object]:
        """Return all numbers, ready for JSON."""
        return {**asdict(self), "tolerance": list(self.tolerance), "fault": self.fault}


class PushTest:
    """Evaluation of pushes for a law, prepared before the robot moves.

    Parameters
    ----------
    push
        The push.
    law
        The law.
    """

    def __init__(self, push: Push, law: Law):
        n = law.n_joints
        self._push, self._period = push, law.period
        self._free = self._alone = np.full(n, np.nan)
        if push.inertia is not None:
            matrix = check.positive_definite("inertia", push.inertia, n)
            self._free, self._alone = np.diag(np.linalg.inv(matrix)), np.diag(matrix)
        inertia = getattr(law, "inertia", None)
        is_constant = inertia is not None and not isinstance(inertia, NominalInertia)
        self._own = np.diag(check.square("inertia", inertia, n)) if is_constant else np.full(n, np.nan)
        self._stable = law_intervals(law) if is_constant else ()

    def response(self, joint: int, torque: Array, positions: Array) -> PushResponse:
        """Return what the positions (k,) of a joint under a torque (k,) show."""
        mobility, certainty, friction = evaluate(torque, positions, self._period)
        return PushResponse(
            joint,
            mobility,
            certainty,
            friction,
            float(self._own[joint] * mobility),
            self._stable,
            (float(mobility / self._free[joint]), float(mobility * self._alone[joint])),
            self._push.tolerance,
            float(np.max(np.abs(torque), initial=0.0)),
        )


def evaluate(torque: Array, positions: Array, period: float) -> tuple[float, float, float]:
    """Return the acceleration per torque of a pushed joint, its ratio to its standard error, and its dry friction.

    The positions are fitted by least squares, with the motion φ_f of a unit inertia from rest under the push p and a
    friction f. Of a grid from 0 to the push, f is the one that leaves least:

        q(t) = c₀ + c₁ t + c₂ t² + μ φ_f(t),    φ̈_f = p − f sgn φ̇_f

    c₂ takes what the holding torque leaves of gravity.

    Parameters
    ----------
    torque
        Push in each period [N m or N], shape (k,).
    positions
        At the start of each period, shape (k,), NaN where missing.
    period
        T [s].
    """
    n = len(torque)
    s = np.arange(n) / n
    is_valid = np.isfinite(positions)
    frictions = np.linspace(0, 1, FRICTIONS, endpoint=False) * np.max(np.abs(torque), initial=0.0)
    best = 0.0, 0.0, 0.0
    least = np.inf
    if np.count_nonzero(is_valid) < MIN_SAMPLES:
        return best
    for friction, response in zip(frictions, unit_responses(torque, frictions, period), strict=True):
        scale = float(np.max(np.abs(response)))
        if scale == 0:
            continue
        basis = np.stack([np.ones(n), s, s**2, response / scale], axis=1)[is_valid]
        normal = basis.T @ basis
        coefficients = np.linalg.solve(normal, basis.T @ positions[is_valid])
        left = positions[is_valid] - basis @ coefficients
        size = float(left @ left)
        if size < least:
            least = size
            variance = np.linalg.inv(normal)[3, 3] * size / (len(basis) - 5)
            deviation = max(float(np.sqrt(variance)), np.finfo(float).eps)
            best = float(coefficients[3]) / scale, float(coefficients[3]) / deviation, float(friction)
    return best


def unit_responses(torque: Array, frictions: Array, period: float) -> Array:
    """Return the motions of a unit inertia from rest under a torque (k,) and dry frictions (m,), shape (m, k)."""
    position, velocity = np.zeros((2, len(frictions)))
    responses = np.zeros((len(torque), len(frictions)))
    for k, push in enumerate(torque):
        responses[k] = position
        from_rest = np.sign(push) * np.maximum(np.abs(push) - frictions, 0.0)
        acceleration = np.where(velocity == 0, from_rest, push - frictions * np.sign(velocity))
        turns = velocity * (velocity + period * acceleration) < 0
        until_rest = np.where(turns, -velocity / np.where(turns, acceleration, 1.0), 0.0)
        left = np.where(turns, period - until_rest, period)
        position = position + until_rest * velocity / 2
        velocity = np.where(turns, 0.0, velocity)
        acceleration = np.where(turns, from_rest, acceleration)
        position = position + left * velocity + left**2 / 2 * acceleration
        velocity = velocity + left * acceleration
    return responses.T


def law_intervals(law: Law) -> tuple[tuple[float, float], ...]:
    """Return the inertia ratios for which a law's loop is stable; empty for a law that has no such loop."""
    try:
        return tuple((float(low), float(high)) for low, high in stable_intervals(law))
    except (UnsupportedLaw, NotLinearisable):
        return ()
