"""A workspace as boxes of angles, and functions of the posture as trigonometric polynomials of these angles."""

from collections.abc import Callable

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.numerics.eigenvalue_proof import Boxes
from tarc.numerics.trig_polynomial import DEGREE, TrigPolynomial

FIT_TOLERANCE = 1e-9
"""Largest difference of a function from its polynomial, over its largest value, at random postures."""
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
    low, high = (boxes[0] - boxes[1]).min(axis=0), (boxes[0] + boxes[1]).max(axis=0)
    rng = np.random.default_rng(0)
    postures = low + rng.random((N_TESTED, len(low))) * (high - low)
    before = [function(postures) for function in functions]
    matters = []
    for joint in np.flatnonzero(high > low):
        moved = postures.copy()
        moved[:, joint] = low[joint] + rng.random(N_TESTED) * (high - low)[joint]
        for values, function in zip(before, functions, strict=True):
            if np.max(np.abs(values - function(moved))) > FIT_TOLERANCE * np.max(np.abs(values)):
                matters.append(int(joint))
                break
    return np.array(matters, dtype=int)


def as_polynomial(
    function: Matrices, label: str, posture: Array, angles: Array, degree: int = DEGREE
) -> TrigPolynomial:
    """Return a function of the posture as a polynomial of some angles, the other joints as in a posture.

    Raises
    ------
    InvalidParameter
        Where it is none.
    """

    def at(values: Array) -> Array:
        postures = np.tile(posture, (len(values), 1))
        postures[:, angles] = values
        return function(postures)

    polynomial = TrigPolynomial.from_samples(at, len(angles), degree)
    tested = np.random.default_rng(1).uniform(-np.pi, np.pi, (N_TESTED, len(angles)))
    expected = at(tested)
    if np.max(np.abs(polynomial(tested) - expected)) > FIT_TOLERANCE * np.max(np.abs(expected), initial=1e-300):
        raise InvalidParameter(
            f"plant: the equations of {label} are no trigonometric polynomial of its joints, as they are for an open "
            "chain of hinges; without a proof, samples and search decide"
        )
    return polynomial


def in_angles(boxes: Boxes, angles: Array) -> Boxes:
    """Return boxes of some of the angles, each once."""
    both = np.unique(np.concatenate([boxes[0][:, angles], boxes[1][:, angles]], axis=1), axis=0)
    return both[:, : len(angles)], both[:, len(angles) :]
