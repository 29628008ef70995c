"""Branch and bound on eigenvalues: against dense sampling, and boxes that must not be settled."""

import numpy as np
import pytest

from tarc.numerics.eigenvalue_proof import BoxTest, positive_definite, prove_below
from tarc.numerics.trig_polynomial import TrigPolynomial


def random_polynomial(seed, n_angles, n):
    rng = np.random.default_rng(seed)
    modes = np.unique(rng.integers(-2, 3, (8, n_angles)), axis=0)
    cosines, sines = rng.standard_normal((2, len(modes), n, n))
    return TrigPolynomial(modes, cosines + cosines.transpose(0, 2, 1), sines + sines.transpose(0, 2, 1))


def largest_at(polynomial, angles):
    return np.linalg.eigvalsh(polynomial(angles))[:, -1]


@pytest.mark.parametrize("n_angles", [1, 2, 3])
def test_no_box_is_settled_in_which_the_bound_does_not_hold(n_angles):
    """Bounds a little above the value at the centre: some boxes are settled, and samples in these stay below."""
    rng = np.random.default_rng(n_angles)
    n_settled = 0
    for seed in range(12):
        polynomial = random_polynomial(seed, n_angles, 4)
        centres = rng.uniform(-3, 3, (40, n_angles))
        halves = rng.uniform(0.0, 0.15, (40, n_angles))
        bound = float(np.quantile(largest_at(polynomial, centres), 0.7))
        below = largest_at(polynomial, centres) < bound
        centres, halves = centres[below], halves[below]
        outcome = BoxTest(polynomial, bound).apply(centres, halves)
        assert outcome.above is None
        settled = np.setdiff1d(np.arange(len(centres)), outcome.left)
        n_settled += len(settled)
        inside = rng.uniform(-1, 1, (60, 1, n_angles))
        inside[:30] = np.sign(inside[:30])
        for i in settled:
            assert largest_at(polynomial, (centres[i] + inside[:, 0] * halves[i])).max() <= bound
        truly_below = [
            largest_at(polynomial, centres[i] + inside[:, 0] * halves[i]).max() <= bound for i in outcome.left
        ]
        assert len(settled) > 0.5 * (len(settled) + sum(truly_below))  # and most of those in which it holds are
    assert n_settled > 100


@pytest.mark.parametrize(("excess", "holds"), [(1e-3, True), (-1e-3, False)])
def test_the_largest_eigenvalue_over_a_box_to_a_thousandth(excess, holds):
    polynomial = random_polynomial(3, 2, 3)
    boxes = np.array([[0.3, -0.5]]), np.array([[1.2, 0.9]])
    axes = [np.linspace(c - h, c + h, 301) for c, h in zip(boxes[0][0], boxes[1][0], strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    largest = largest_at(polynomial, grid).max()
    proof = prove_below([polynomial], [largest + excess * abs(largest)], boxes)
    assert proof.complete is holds
    if proof.counterexample is not None:
        assert largest_at(polynomial, proof.counterexample[1][None])[0] > largest * (1 - 1e-3) - 1e-9


def test_terms_left_out_and_rounding_are_taken_from_the_bound():
    polynomial = random_polynomial(1, 1, 2)
    vague = TrigPolynomial(polynomial.modes, polynomial.cosines, polynomial.sines, left_out=0.5)
    point = np.array([[0.2]])
    value = largest_at(polynomial, point)[0]
    still = point, 0 * point
    assert prove_below([polynomial], [value + 1e-5], still).complete
    assert not prove_below([vague], [value + 0.49], still).complete
    assert not prove_below([polynomial], [value + 1e-10], still).complete


def test_two_functions_and_what_is_left_of_each():
    first, second = random_polynomial(4, 2, 2), random_polynomial(5, 2, 2)
    boxes = np.zeros((1, 2)), np.full((1, 2), np.pi)
    bounds = [1.05 * f.sup_norm() for f in (first, second)]
    assert prove_below([first, second], bounds, boxes).complete
    stopped = prove_below([first, second], bounds, boxes, time_limit=0.0)
    assert stopped.share == 0
    assert [len(c) for c, _ in stopped.open_boxes] == [1, 1]
    assert prove_below([first, second], bounds, boxes, open_boxes=stopped.open_boxes).complete


def test_pivots_tell_positive_definite_matrices():
    rng = np.random.default_rng(0)
    matrices = rng.standard_normal((500, 5, 5))
    matrices = matrices + matrices.transpose(0, 2, 1) + rng.uniform(0, 8, (500, 1, 1)) * np.eye(5)
    expected = np.linalg.eigvalsh(matrices)[:, 0] > 0
    assert 50 < expected.sum() < 450
    assert np.array_equal(positive_definite(matrices), expected)
