"""A workspace as boxes of angles, and functions of the posture as trigonometric polynomials of these angles."""

from collections.abc import Callable

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.numerics.eigenvalue_proof import Boxes
from tarc.numerics.trig_polynomial import DEGREE, TrigPolynomial

FIT_TOLERANCE = 1e-10
"""Largest difference of a function from its polynomial at random postures, over the largest value of all functions."""
N_TESTED = 64
"""Number of those postures."""
SMALLEST_REACH = 0.02
"""Half width [rad] that boxes about a reference may always have."""
MAX_PIECES = 2000
"""Largest number of boxes about a reference."""

Matrices = Callable[[Array], Array]
"""A function from postures (k, n) to matrices."""


def workspace_boxes(workspace: Workspace) -> Boxes:
    """Return boxes that contain all postures of a workspace, each array (k, n).

    A range of a full turn or more becomes one turn, since angles repeat. The tube about a reference lies in one box per
    piece of time. In half a piece no joint moves farther than its largest speed, taken as 1.2 times that of 20,001
    samples, allows.
    """
    if workspace.reference is None:
        centres, halves = (workspace.low + workspace.high)[None] / 2, (workspace.high - workspace.low)[None] / 2
        return centres, np.minimum(halves, np.pi)
    tube = workspace.high[1:]
    speed = workspace.with_reference_speeds().speed
    speed = np.zeros(workspace.n_joints) if speed is None else speed
    duration = workspace.high[0] - workspace.low[0]
    pieces = np.ceil(np.max(speed * duration / 2 / np.maximum(tube, SMALLEST_REACH)))
    n_pieces = int(np.clip(pieces, 1, MAX_PIECES))
    times = workspace.low[0] + (np.arange(n_pieces) + 0.5) * duration / n_pieces
    variables = np.column_stack([times, np.zeros((n_pieces, workspace.n_joints))])
    halves = np.tile(tube + speed * duration / n_pieces / 2, (n_pieces, 1))
    return workspace.positions(variables), np.minimum(halves, np.pi)


def angles_that_matter(functions: list[Matrices], boxes: Boxes) -> Array:
    """Return the joints that move in the boxes and on which a function depends, by its change at random postures."""
    postures, moved_postures = _random_postures(boxes)
    before = [function(postures) for function in functions]
    scale = max(float(np.max(np.abs(values))) for values in before)
    matters = []
    for joint, moved in moved_postures.items():
        changes = (np.max(np.abs(f(moved) - values)) for f, values in zip(functions, before, strict=True))
        if any(change > FIT_TOLERANCE * scale for change in changes):
            matters.append(joint)
    return np.array(matters, dtype=int)


def _random_postures(boxes: Boxes) -> tuple[Array, dict[int, Array]]:
    """Return postures, and the same with another angle of one joint, by that joint."""
    low, high = (boxes[0] - boxes[1]).min(axis=0), (boxes[0] + boxes[1]).max(axis=0)
    rng = np.random.default_rng(0)
    postures = low + rng.random((N_TESTED, len(low))) * (high - low)
    moved = {}
    for joint in np.flatnonzero(high > low).tolist():
        moved[joint] = postures.copy()
        moved[joint][:, joint] = low[joint] + rng.random(N_TESTED) * (high - low)[joint]
    return postures, moved


def as_polynomials(
    functions: list[Matrices], label: str, posture: Array, angles: Array, degree: int = DEGREE
) -> list[TrigPolynomial]:
    """Return functions of the posture as polynomials of some angles, the other joints as in a posture.

    Raises
    ------
    InvalidParameter
        Where one is none.
    """
    tested = np.random.default_rng(1).uniform(-np.pi, np.pi, (N_TESTED, len(angles)))

    def of_angles(function: Matrices) -> Matrices:
        def at(values: Array) -> Array:
            postures = np.tile(posture, (len(values), 1))
            postures[:, angles] = values
            return function(postures)

        return at

    reduced = [of_angles(function) for function in functions]
    polynomials = [TrigPolynomial.from_samples(function, len(angles), degree) for function in reduced]
    expected = [function(tested) for function in reduced]
    scale = max(float(np.max(np.abs(values))) for values in expected)
    for polynomial, values in zip(polynomials, expected, strict=True):
        if np.max(np.abs(polynomial(tested) - values)) > FIT_TOLERANCE * scale:
            raise InvalidParameter(
                f"plant: the equations of {label} are no trigonometric polynomial of its joints, as they are for an "
                "open chain of hinges; without a proof, samples and search decide"
            )
    return polynomials


def in_angles(boxes: Boxes, angles: Array) -> Boxes:
    """Return boxes of some of the angles, each once."""
    both = np.unique(np.concatenate([boxes[0][:, angles], boxes[1][:, angles]], axis=1), axis=0)
    return both[:, : len(angles)], both[:, len(angles) :]
