"""Proves the bounds of a robot's certificate one after the other, in every posture of its workspace."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from tarc.analysis.inertia_ratio import inertia_matrices
from tarc.analysis.motion_forces import MotionCorners
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, OperatingPoint, matrix_roots
from tarc.analysis.stored_proof import prove_stored
from tarc.analysis.workspace import Workspace
from tarc.analysis.workspace_boxes import Matrices, angles_that_matter, as_polynomials, in_angles, workspace_boxes
from tarc.certificates.affine_cover import with_fewest_bounds
from tarc.certificates.ball import Ball
from tarc.certificates.base import Verdict
from tarc.certificates.force_form import ForceForm
from tarc.certificates.grouped_forces import GroupBound, GroupsLeftOut, cover_groups, group_bounds
from tarc.certificates.robot_evidence import AffineCover, MaxRatePoint, RobotEvidence, linearised_point
from tarc.core.types import Array
from tarc.numerics.trig_polynomial import PolynomialFamily, TrigPolynomial, too_large
from tarc.plants.base import Plant

MAX_CORNERS = 2100
"""Largest number of corners of the motions whose forces are proven; three joints have 256, four 2,048."""
TANGENTS = 3, 5
"""Numbers of tangents to try, see `tarc.analysis.motion_forces`."""
MAX_GRID = 20_000
"""Largest number of postures on which the forces are evaluated to make polynomials of them."""
TIME_ENDED = "the time ended"
"""Why a bound stays open that needs more time."""
RELAXED = "a corner of the motions that no motion reaches breaks it; search decides"
"""Why a bound may stay open although no motion breaks it."""


@dataclass(frozen=True)
class ProvenPart:
    """One of the bounds of a certificate, and for which share of the workspace it is proven.

    Attributes
    ----------
    name
        What is bounded.
    limit
        The bound, in words.
    share
        Proven share of the workspace, 1 for all of it.
    n_boxes
        Number of boxes that were looked at.
    reason
        Why it was not tried or did not end; empty for a proof.
    """

    name: str
    limit: str
    share: float
    n_boxes: int
    reason: str = ""

    @property
    def complete(self) -> bool:
        """Whether the bound holds in every posture."""
        return self.share >= 1

    def __str__(self) -> str:
        reason = f" ({self.reason})" if self.reason else ""
        percent = "100 %" if self.complete else f"{100 * min(self.share, 0.9999):.4g} %"
        return f"{self.name} {self.limit}: {percent}{reason}"


class BrokenBound(Exception):
    """A posture in which a bound does not hold, and the evidence with it."""

    def __init__(self, evidence: RobotEvidence, posture: Array):
        self.evidence, self.posture = evidence, posture


@dataclass(eq=False)
class BoundProver:
    """Proves the bounds of a certificate one after the other."""

    plants: Sequence[Plant]
    nominal: Array
    workspace: Workspace
    evidence: RobotEvidence
    deadline: float
    progress: bool | None

    def __post_init__(self) -> None:
        self.inverse_root = matrix_roots(self.nominal)[1]
        self.boxes = workspace_boxes(self.workspace)
        n = self.workspace.n_joints
        limits = [self.workspace.speed, self.workspace.acceleration]
        self.speed, self.acceleration = (np.zeros(n) if limit is None else np.asarray(limit) for limit in limits)
        damping = np.array([plant.damping(self.boxes[0][0]) for plant in self.plants])
        self.has_friction = bool(np.abs(damping).max() > NEGLIGIBLE_STIFFNESS)
        functions = [self._scaled_inertia(plant) for plant in self.plants]
        self.angles = angles_that_matter(functions, self.boxes)
        self.inertias = [self._polynomial(*pair) for pair in zip(functions, self.plants, strict=True)]

    def parts(self) -> Iterator[ProvenPart]:
        """Prove all bounds of the certificate."""
        cover, ball = self.evidence.affine, self.evidence.ball
        if cover is not None:
            ratios = cover.proof.ratios
            yield self._ratios(ratios.min_ratio, ratios.max_ratio)
            yield self._rate(ratios.rate, relative=False)
            yield self._rate(ratios.relative_rate, relative=True)
            if not ratios.has_forces:
                yield self._forces("no stiffness", NEGLIGIBLE_STIFFNESS, 0.0, 1.0)
            elif self._corners(TANGENTS[0]).count() > MAX_CORNERS:
                yield from self._forces_by_groups(cover)
                return
            if ratios.form is not None:
                yield self._form(ratios.form)
            for i, stiffness in enumerate(ratios.stiffness):
                power, lead_time = float(ratios.powers[i]), float(ratios.lead_times[i])
                yield self._forces("forces", float(stiffness), lead_time, power)
        elif ball is not None:
            yield from self._ball_parts(ball)

    def _ball_parts(self, ball: Ball) -> Iterator[ProvenPart]:
        radius, weight = ball.radius, ball.position_weight
        lead_time = ball.loop.lead_periods.item() * self.evidence.period
        yield self._ratios(ball.centre - radius, ball.centre + radius)
        if ball.max_change is not None:
            yield self._rate(ball.max_change / self.evidence.period, relative=False)
        if not weight > 0:
            yield self._forces("no stiffness", NEGLIGIBLE_STIFFNESS, 0.0, 1.0)
            return
        yield self._ball(ball.centre, radius, weight, lead_time)
        if ball.max_change is not None and ball.stiffness < radius * weight:
            name = "stiffness" if len(self.plants) == 1 else "stiffness at each payload given"
            yield self._forces(name, ball.stiffness, lead_time, 0.0)

    def _ratios(self, low: float, high: float) -> ProvenPart:
        """Prove that all ratios are within two ends."""
        functions = [sign * inertia for inertia in self.inertias for sign in (1.0, -1.0)]
        bounds = [1 / low if low > 0 else np.inf, -1 / high] * len(self.inertias)
        return self._prove("inertia ratios", f"from {low:.4g} to {high:.4g}", functions, bounds, self._at_rest)

    def _rate(self, limit: float, *, relative: bool) -> ProvenPart:
        """Prove that J changes no faster, relative to M̂ or to itself."""
        name = "relative rate of the inertia" if relative else "rate of the inertia"
        moving = [place for place, angle in enumerate(self.angles) if self.speed[angle] > 0]
        if not moving:
            return ProvenPart(name, "zero", 1.0, 0)
        functions: list[TrigPolynomial] = []
        for inertia in self.inertias:
            slopes = [float(self.speed[self.angles[place]]) * inertia.derivative(place) for place in moving]
            start = (-limit if relative else 0.0) * inertia
            weights = [np.array([1.0, *signs]) for signs in product((-1.0, 1.0), repeat=len(moving))]
            functions += PolynomialFamily.from_parts([start, *slopes], weights).members()
        bounds = [0.0 if relative else limit] * len(functions)
        return self._prove(name, f"up to {limit:.4g} 1/s", functions, bounds, self._fastest)

    def _forces(self, name: str, limit: float, lead_time: float, power: float) -> ProvenPart:
        """Prove ‖E^−p [H, C/θ]‖ ≤ κ."""
        words = f"up to {limit:.4g} 1/s² (p = {power:g}, θ = {lead_time:.3g} s)"
        n = self.workspace.n_joints

        def fixed(J: Array) -> Array:
            matrix = np.zeros((len(J), 3 * n, 3 * n))
            matrix[:, :n, :n] = np.eye(n) - (np.eye(n) if power == 1 else J if power else J @ J)
            return matrix

        def with_forces(K: Array) -> Array:
            return _symmetric(K / limit, 0, n, 3 * n)

        return self._prove_forces(name, words, lead_time, fixed, with_forces, degree=2 if power else 4)

    def _form(self, form: ForceForm) -> ProvenPart:
        """Prove α0 |k|² + α1 kᵀEk + 2 α2 ẋᵀk ≤ β0 |x|² + β1 |ẋ|² for k = −R y, with β0 |x|² + β1 |ẋ|² = |y|².

        With W the last columns of β1^−½ R it is [I + α2 (W + Wᵀ), α0^½ Rᵀ, α1^½ Rᵀ; ·, I, 0; ·, 0, J] ⪰ 0.
        """
        words = f"α0 = {form.torque:.3g}, α1 = {form.energy:.3g}, α2 = {form.power:.3g} 1/s, "
        words += f"β0 = {form.position:.4g} 1/s⁴, β1 = {form.velocity:.4g} 1/s²"
        n = self.workspace.n_joints

        def fixed(J: Array) -> Array:
            matrix = np.zeros((len(J), 4 * n, 4 * n))
            matrix[:, 3 * n :, 3 * n :] = np.eye(n) - J
            return matrix

        def with_forces(K: Array) -> Array:
            R, k = K / form.position**0.5, len(K)
            work = np.zeros((k, 4 * n, 4 * n))
            work[:, n : 2 * n, : 2 * n] = form.power / form.velocity**0.5 * R
            parts = np.concatenate([form.torque**0.5 * R, form.energy**0.5 * R], axis=1).transpose(0, 2, 1)
            return _symmetric(parts, 0, 2 * n, 4 * n) - work - work.transpose(0, 2, 1)

        return self._prove_forces("forces", words, form.lead_time, fixed, with_forces, degree=2)

    def _forces_by_groups(self, cover: AffineCover) -> Iterator[ProvenPart]:
        """Prove the forces by groups, with a Lyapunov function that covers their sum."""
        limits = ", ".join(f"{stiffness:.4g}" for stiffness in cover.proof.ratios.stiffness)
        limits = f"up to {limits} 1/s²" if limits else "within their form"
        corners, before = self._corners(TANGENTS[0]), self.evidence
        bounds: list[GroupBound] | None
        try:
            bounds = group_bounds(self.plants, self.inverse_root, corners, self.boxes, deadline=self.deadline)
        except GroupsLeftOut as reason:
            yield ProvenPart("forces", limits, 0.0, 0, f"bounds by groups are left out: {reason}; search decides")
            return
        parts: list[ProvenPart] = []
        while bounds is not None:
            grown = cover_groups(cover, bounds)
            if grown is None:
                break
            grown = with_fewest_bounds(grown)
            self.evidence = replace(before, affine=grown)
            parts, bounds = self._prove_groups(bounds)
            if bounds is None and self.evidence.judge().verdict == Verdict.CERTIFIED:
                share = min(part.share for part in parts)
                reason = next((part.reason for part in parts if part.reason), "")
                yield from parts
                yield ProvenPart("all forces", self._growth(grown), share, 0, reason)
                return
        self.evidence = before
        reason = f"{corners.count()} corners of the motions are too many, and no Lyapunov function covers their"
        yield ProvenPart("forces", limits, 0.0, 0, f"{reason} bounds by groups; search decides")

    def _prove_groups(self, bounds: Sequence[GroupBound]) -> tuple[list[ProvenPart], list[GroupBound] | None]:
        """Prove the bounds of groups of forces; return larger ones as well where a posture is above one."""
        parts: list[ProvenPart] = []
        for place, bound in enumerate(bounds):
            functions = bound.scaled()
            met: list[tuple[int, Array]] = []

            def add(index: int, posture: Array, met: list[tuple[int, Array]] = met) -> None:
                met.append((index, posture))

            parts.append(
                self._prove(bound.group.name, str(bound), functions, [1.0] * len(functions), add, bound.angles)
            )
            if met:
                larger = list(bounds)
                larger[place] = replace(bound, largest=max(bound.limit, bound.norm_at(*met[0])))
                return parts, larger
        return parts, None

    def _growth(self, cover: AffineCover) -> str:
        """Return the bounds on the sum of all groups, and how much larger they are than what was found."""
        ratios, points = cover.proof.ratios, self.evidence.uncertainty(cover.force_points).with_friction()
        lines = []
        for lead_time, stiffness in zip(ratios.lead_times, ratios.stiffness, strict=True):
            largest = float(points.force_norms(float(lead_time)).max())
            growth = f"{stiffness / largest:.3g} times the largest found"
            lines.append(f"up to {stiffness:.4g} 1/s² (p = 1, θ = {lead_time:.3g} s), {growth}")
        return " and ".join(lines)

    def _corners(self, n_tangents: int) -> MotionCorners:
        return MotionCorners(tuple(self.speed), tuple(self.acceleration), n_tangents, self.has_friction)

    def _ball(self, centre: float, radius: float, weight: float, lead_time: float) -> ProvenPart:
        """Prove ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ."""
        words = f"up to {radius:.4g} about {centre:.4g} (η = {weight:.4g} 1/s², θ = {lead_time:.3g} s)"
        n, factor = self.workspace.n_joints, np.sqrt(max(centre**2 - radius**2, 0.0))

        def fixed(J: Array) -> Array:
            matrix = _symmetric(-factor * J, 0, n, 4 * n)
            matrix[:, :n, :n] = 2 * np.eye(n) - 2 * centre * J
            return matrix

        def with_forces(K: Array) -> Array:
            return _symmetric(K / weight, 0, 2 * n, 4 * n)

        return self._prove_forces("ratios and forces", words, lead_time, fixed, with_forces, degree=2)

    def _prove_forces(
        self,
        name: str,
        words: str,
        lead_time: float,
        fixed: Callable[[Array], Array],
        with_forces: Callable[[Array], Array],
        *,
        degree: int,
    ) -> ProvenPart:
        """Prove that fixed(J) + with_forces(K) ≺ I at all motions."""
        part = ProvenPart(name, words, 0.0, 0)
        for n_tangents in TANGENTS:
            corners = self._corners(n_tangents)
            if corners.count() > MAX_CORNERS:
                reason = f"{corners.count()} corners of the motions are too many; search decides"
                return replace(part, reason=part.reason or reason)
            rows = [
                [
                    lambda postures, plant=plant: fixed(self._scaled_inertia(plant)(postures)),
                    *(self._scaled_forces(function, lead_time, with_forces) for function in corners.parts(plant)),
                ]
                for plant in self.plants
            ]
            angles = angles_that_matter([function for row in rows for function in row], self.boxes)
            n_grid, n_rows = (2 * degree + 1) ** len(angles), rows[0][0](self.boxes[0][:1]).shape[1]
            if n_grid > MAX_GRID:
                return replace(part, reason=f"they depend on {len(angles)} angles; search decides")
            if reason := too_large(len(rows) * len(rows[0]), n_grid, n_rows):
                return replace(part, reason=f"{reason}; search decides")
            motions = corners.corners()
            weights = [np.concatenate([[1.0], corners.weights(*motion)]) for motion in motions]
            families = [
                PolynomialFamily.from_parts(as_polynomials(row, plant.label, self.boxes[0][0], angles, degree), weights)
                for row, plant in zip(rows, self.plants, strict=True)
            ]
            if reason := too_large(len(rows) * len(weights), 2 * families[-1].n_modes, n_rows):
                return replace(part, reason=f"{reason}; search decides")
            functions = [member for family in families for member in family.members()]
            breaks = partial(self._break_motion, motions)
            part = self._prove(name, words, functions, [1.0] * len(functions), breaks, angles)
            if part.reason != RELAXED:
                return part
        return part

    def _scaled_forces(self, function: Matrices, lead_time: float, with_forces: Callable[[Array], Array]) -> Matrices:
        """Return a function of K = M̂^−½ [G, D/θ] M̂^−½; without a lead time D must be negligible."""
        scale, unit = self.inverse_root, lead_time if lead_time > 0 else NEGLIGIBLE_STIFFNESS

        def at(postures: Array) -> Array:
            G, D = np.split(function(postures), 2, axis=2)
            return with_forces(np.concatenate([scale @ G @ scale, scale @ D @ scale / unit], axis=2))

        return at

    def _break_motion(self, motions: list[tuple[Array, Array, Array]], index: int, posture: Array) -> None:
        """Raise for a corner of the motions that is a motion, in a posture."""
        v, s, a = motions[index % len(motions)]
        if np.array_equal(s, v**2):
            plant = self.plants[index // len(motions)]
            self._break(OperatingPoint(plant, posture, v * self.speed, a * self.acceleration))

    def _prove(
        self,
        name: str,
        limit: str,
        functions: Sequence[TrigPolynomial],
        bounds: Sequence[float],
        on_counterexample: Callable[[int, Array], None],
        angles: Array | None = None,
    ) -> ProvenPart:
        """Prove that functions stay below bounds; what breaks one goes to the function given."""
        angles = self.angles if angles is None else angles
        finite = [i for i, bound in enumerate(bounds) if np.isfinite(bound)]
        proof = prove_stored(
            [functions[i] for i in finite],
            [bounds[i] for i in finite],
            in_angles(self.boxes, angles),
            label=f"proving {name}",
            time_limit=max(self.deadline - time.monotonic(), 0.0),
            progress=self.progress,
        )
        if proof.counterexample is not None:
            index, values = proof.counterexample
            posture = self.boxes[0][0].copy()
            posture[angles] = values
            on_counterexample(finite[index], posture)
            return ProvenPart(name, limit, 0.0, proof.n_boxes, RELAXED)
        reason = "" if proof.complete else TIME_ENDED
        return ProvenPart(name, limit, proof.share, proof.n_boxes, reason)

    def _at_rest(self, index: int, posture: Array) -> None:
        self._break(OperatingPoint.at_rest(self.plants[index // 2], posture))

    def _fastest(self, index: int, posture: Array) -> None:
        n_signs = 2 ** int(np.sum(self.speed[self.angles] > 0))
        point = OperatingPoint.at_rest(self.plants[index // n_signs], posture)
        rate_point, evidence = MaxRatePoint.from_point(point, self.workspace), self.evidence
        cover = evidence.affine
        if cover is None:
            raise BrokenBound(replace(evidence, max_rate_point=rate_point), posture)
        cover = replace(cover, rate_points=(*cover.rate_points, rate_point))
        raise BrokenBound(replace(evidence, affine=cover), posture)

    def _break(self, point: OperatingPoint) -> None:
        """Raise with the evidence to which a point is added that its bounds leave out."""
        evidence, linearised = self.evidence, linearised_point(point)
        cover = evidence.affine
        if cover is not None:
            cover = replace(cover, force_points=(*cover.force_points, linearised))
            raise BrokenBound(replace(evidence, affine=cover), point.position)
        name = "largest_norm_moving" if point.is_moving else "largest_norm"
        raise BrokenBound(replace(evidence, points=replace(evidence.points, **{name: linearised})), point.position)

    def _scaled_inertia(self, plant: Plant) -> Matrices:
        return lambda postures: self.inverse_root @ inertia_matrices(plant, postures) @ self.inverse_root

    def _polynomial(self, function: Matrices, plant: Plant) -> TrigPolynomial:
        return as_polynomials([function], plant.label, self.boxes[0][0], self.angles)[0]


def _symmetric(block: Array, row: int, column: int, size: int) -> Array:
    """Return symmetric matrices with a block above the diagonal, and its transpose below."""
    k, height, width = block.shape
    matrix = np.zeros((k, size, size))
    matrix[:, row : row + height, column : column + width] = block
    matrix[:, column : column + width, row : row + height] = block.transpose(0, 2, 1)
    return matrix
