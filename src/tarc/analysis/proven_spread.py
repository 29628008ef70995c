"""The range of the inertia ratio over a box of postures, proven by branch and bound."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread, as_plants, inertia_spread
from tarc.analysis.operating_points import matrix_roots
from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.progress import Progress
from tarc.core.types import Array
from tarc.core.validation import Matrix
from tarc.numerics.trig_polynomial import Proof, TrigPolynomial, prove_below
from tarc.plants.base import Plant

FIT_TOLERANCE = 1e-9
"""Largest difference of M(q) from its polynomial, over its norm, at random postures."""
N_TESTED = 64
"""Number of those postures."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProvenSpread:
    """Bounds on the eigenvalues of M(q)⁻¹M̂ over a workspace.

    Attributes
    ----------
    min_ratio, max_ratio
        No posture in the proven share has an eigenvalue outside of these.
    share
        Share of the workspace for which both are proven, of the worse of the two.
    n_boxes
        Number of boxes that were looked at.
    found
        The extremes that samples and local search found.
    """

    min_ratio: float
    max_ratio: float
    share: float
    n_boxes: int
    found: InertiaSpread

    @property
    def complete(self) -> bool:
        """Whether the bounds are proven for every posture of the workspace."""
        return self.share >= 1


def prove_inertia_spread(
    plant: Plant | Sequence[Plant],
    inertia: Matrix,
    workspace: Workspace,
    *,
    tolerance: float = 0.02,
    time_limit: float = 60.0,
    samples: int = 2000,
    seed: int = 0,
    progress: bool | None = None,
) -> ProvenSpread:
    """Prove a range of the eigenvalues of M(q)⁻¹M̂ for every posture of a box, and not on samples.

    M(q) of an open chain is a trigonometric polynomial of degree two in each angle. So M̂^−½ M(q) M̂^−½ follows exactly
    from its values on a grid. Its derivatives bound its eigenvalues over a box of postures. The extremes that
    `inertia_spread` finds, each widened by the tolerance, are proven by branch and bound. A posture beyond them widens
    the range and begins the proof anew.

    The number of boxes grows with the number of angles on which M(q) depends: two or three take a fraction of a second,
    five take minutes.

    Parameters
    ----------
    plant
        One robot or several, such as one without and one with its payload. M grows with the payload, in the order of
        symmetric matrices. So these two stand for every payload between.
    inertia
        M̂ [kg m² or kg], as for a law.
    workspace
        A box of postures.
    tolerance
        Share by which the proven range is wider than the one found, at each end.
    time_limit
        Time after which a proof stops as it is, with the share that it has proven [s].
    samples, seed
        Of `inertia_spread`.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        For a workspace about a reference, a robot whose M(q) is no such polynomial, as with joints that slide, and as
        `inertia_spread`.
    """
    plants = as_plants(plant)
    nominal = check.positive_definite("inertia", inertia, plants[0].n_joints)
    check.number("tolerance", tolerance, 0, strict=True)
    check.number("time_limit", time_limit, 0, strict=True)
    if workspace.reference is not None:
        raise InvalidParameter(
            "workspace: a proof needs a box of postures; give the ranges of all joints with Workspace.box(low, high)"
        )
    found = inertia_spread(plants, nominal, workspace, samples=samples, seed=seed)
    angles = _angles(plants, workspace)
    centre, half = (workspace.low + workspace.high) / 2, (workspace.high - workspace.low) / 2
    largest, smallest = 1 / found.min_ratio, 1 / found.max_ratio
    if not len(angles):
        return ProvenSpread(
            min_ratio=found.min_ratio / (1 + tolerance),
            max_ratio=found.max_ratio * (1 + tolerance),
            share=1.0,
            n_boxes=0,
            found=found,
        )
    polynomials = [_scaled_inertia(one, nominal, centre, angles) for one in plants]
    deadline = time.monotonic() + time_limit
    shares, n_boxes = [], 0
    with Progress("proving the inertia ratios", 200, progress) as bar:
        for sign in (1, -1):
            while True:
                bound = largest * (1 + tolerance) if sign > 0 else -smallest / (1 + tolerance)
                proof = _prove(polynomials, sign, bound, centre[angles], half[angles], deadline, bar)
                n_boxes += proof.n_boxes
                if proof.counterexample is None:
                    break
                values = np.concatenate([np.linalg.eigvalsh(part(proof.counterexample[None])) for part in polynomials])
                largest, smallest = max(largest, float(values.max())), min(smallest, float(values.min()))
            shares.append(proof.share if not proof.complete else 1.0)
    return ProvenSpread(
        min_ratio=1 / (largest * (1 + tolerance)),
        max_ratio=(1 + tolerance) / smallest,
        share=min(shares),
        n_boxes=n_boxes,
        found=found,
    )


def _prove(
    polynomials: Sequence[TrigPolynomial],
    sign: int,
    bound: float,
    centre: Array,
    half: Array,
    deadline: float,
    bar: Progress,
) -> Proof:
    """Prove that no eigenvalue times the sign is above the bound."""
    shown = 0

    def show(share: float) -> None:
        nonlocal shown
        reached = int(100 * share)
        for _ in range(reached - shown):
            bar.advance()
        shown = max(shown, reached)

    functions = [float(sign) * polynomial for polynomial in polynomials]
    limits = [bound] * len(functions)
    time_left = max(deadline - time.monotonic(), 0.0)
    return prove_below(functions, limits, centre[None], half[None], time_limit=time_left, on_share=show)


def _angles(plants: Sequence[Plant], workspace: Workspace) -> Array:
    """Return the joints with a range on which M(q) depends, by its change over postures at random."""
    rng = np.random.default_rng(0)
    postures = workspace.low + rng.random((N_TESTED, workspace.n_joints)) * (workspace.high - workspace.low)
    matters = []
    for joint in np.flatnonzero(workspace.high > workspace.low):
        moved = postures.copy()
        moved[:, joint] = workspace.low[joint] + rng.random(N_TESTED) * (workspace.high - workspace.low)[joint]
        for plant in plants:
            before, after = _inertias(plant, postures), _inertias(plant, moved)
            if np.max(np.abs(before - after)) > FIT_TOLERANCE * np.max(np.abs(before)):
                matters.append(int(joint))
                break
    return np.array(matters, dtype=int)


def _inertias(plant: Plant, postures: Array) -> Array:
    return np.array([plant.inertia(posture) for posture in postures])


def _scaled_inertia(plant: Plant, nominal: Array, centre: Array, angles: Array) -> TrigPolynomial:
    """Return M̂^−½ M(q) M̂^−½ as a polynomial of some angles, the other joints at the centre.

    Raises
    ------
    InvalidParameter
        Where it is none.
    """
    inverse_root = matrix_roots(nominal)[1]

    def scaled(values: Array) -> Array:
        postures = np.tile(centre, (len(values), 1))
        postures[:, angles] = values
        return inverse_root @ _inertias(plant, postures) @ inverse_root

    polynomial = TrigPolynomial.from_samples(scaled, len(angles))
    tested = np.random.default_rng(1).uniform(-np.pi, np.pi, (N_TESTED, len(angles)))
    expected = scaled(tested)
    if np.max(np.abs(polynomial(tested) - expected)) > FIT_TOLERANCE * np.max(np.abs(expected)):
        raise InvalidParameter(
            f"plant: M(q) of {plant.label} is no trigonometric polynomial of degree two in its joints, as it is for an "
            "open chain of hinges; without a proof, inertia_spread samples it"
        )
    return polynomial
