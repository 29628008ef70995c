"""The range of the inertia ratio over a box of postures, proven by branch and bound."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread, as_plants, inertia_matrices, inertia_spread
from tarc.analysis.operating_points import matrix_roots
from tarc.analysis.stored_proof import prove_stored
from tarc.analysis.workspace import Workspace
from tarc.analysis.workspace_boxes import Matrices, angles_that_matter, as_polynomials, in_angles, workspace_boxes
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.core.validation import Matrix
from tarc.numerics.eigenvalue_proof import Boxes
from tarc.numerics.trig_polynomial import TrigPolynomial
from tarc.plants.base import Plant


@dataclass(frozen=True, kw_only=True, eq=False)
class ProvenSpread:
    """Bounds on the eigenvalues of M(q)⁻¹M̂ over a workspace.

    Attributes
    ----------
    min_ratio, max_ratio
        No posture in the proven share has an eigenvalue outside of these.
    share
        Share of the workspace for which they are proven, the mean over the robots and the two ends.
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
    """Prove a range of the eigenvalues of M(q)⁻¹M̂ for every posture of a workspace, and not on samples.

    M(q) of an open chain is a trigonometric polynomial of degree two in each angle. So M̂^−½ M(q) M̂^−½ follows exactly
    from its values on a grid. Its derivatives bound its eigenvalues over a box of postures. The extremes that
    `inertia_spread` finds, each widened by the tolerance, are proven by branch and bound. A posture beyond them widens
    the range and begins the proof anew.

    The number of boxes grows with the number of angles on which M(q) depends. Two or three take a fraction of a second,
    five seconds to minutes, six hours. A proof that time or Ctrl-C ends goes on from there in the next call, by a file
    in the folder `tarc.analysis.stored_proof.proofs_folder`.

    Parameters
    ----------
    plant
        One robot or several, such as one without and one with its payload. M grows with the payload, in the order of
        symmetric matrices. So these two stand for every payload between.
    inertia
        M̂ [kg m² or kg], as for a law.
    workspace
        The postures. The tube about a reference is covered by boxes.
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
        For a robot whose M(q) is no such polynomial, as with joints that slide, and as `inertia_spread`.
    KeyboardInterrupt
        For Ctrl-C; what was proven is kept.
    """
    plants = as_plants(plant)
    nominal = check.positive_definite("inertia", inertia, plants[0].n_joints)
    check.number("tolerance", tolerance, 0, strict=True)
    check.number("time_limit", time_limit, 0, strict=True)
    found = inertia_spread(plants, nominal, workspace, samples=samples, seed=seed)
    polynomials, boxes = inertia_polynomials(
        plants, nominal, workspace_boxes(workspace.for_joints(plants[0].joint_names))
    )
    largest, smallest, n_boxes = 1 / found.min_ratio, 1 / found.max_ratio, 0
    deadline = time.monotonic() + time_limit
    functions = [sign * polynomial for polynomial in polynomials for sign in (1.0, -1.0)]
    while True:
        bounds = [largest * (1 + tolerance), -smallest / (1 + tolerance)] * len(polynomials)
        proof = prove_stored(
            functions,
            bounds,
            boxes,
            label="proving the inertia ratios",
            time_limit=max(deadline - time.monotonic(), 0.0),
            progress=progress,
        )
        n_boxes += proof.n_boxes
        if proof.counterexample is None:
            break
        values = [np.linalg.eigvalsh(polynomial(proof.counterexample[1][None])) for polynomial in polynomials]
        largest, smallest = max(largest, float(np.max(values))), min(smallest, float(np.min(values)))
    return ProvenSpread(
        min_ratio=1 / (largest * (1 + tolerance)),
        max_ratio=(1 + tolerance) / smallest,
        share=proof.share,
        n_boxes=n_boxes,
        found=found,
    )


def inertia_polynomials(plants: Sequence[Plant], nominal: Array, boxes: Boxes) -> tuple[list[TrigPolynomial], Boxes]:
    """Return M̂^−½ M(q) M̂^−½ of each plant as polynomials of the angles on which any depends, and boxes of these.

    Raises
    ------
    InvalidParameter
        For a robot whose M(q) is no such polynomial.
    """
    inverse_root = matrix_roots(nominal)[1]

    def scaled(plant: Plant) -> Matrices:
        return lambda postures: inverse_root @ inertia_matrices(plant, postures) @ inverse_root

    functions = [scaled(plant) for plant in plants]
    angles = angles_that_matter(functions, boxes)
    polynomials = [
        as_polynomials([function], plant.label, boxes[0][0], angles)[0]
        for function, plant in zip(functions, plants, strict=True)
    ]
    return polynomials, in_angles(boxes, angles)
