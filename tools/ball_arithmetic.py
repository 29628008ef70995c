"""Proofs in balls for `check_certificate`: signs of forms, also over an interval or the unit circle, and stability."""

import itertools
import math
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, arb_poly

LOOSE = 1 + arb(2) ** -27  # widens the bounds that the file has in floating point
LEAST = arb(2) ** -120  # squared stiffness that counts as none
ROOM = 1.05  # what is needed may grow by this factor, since the worst points come from samples


def ball(x):
    return np.vectorize(lambda value: arb(float(value)), otypes=[object])(np.array(x, dtype=float))


def symmetric(x):
    if not np.array_equal(x, np.transpose(x)):
        raise ValueError("a matrix is not symmetric")
    return ball(x)


def within_period(lead, T):
    """Return (T/π)√((T/π)² + θ²), by which an acceleration adds to (x, θẋ) within a period (Wirtinger)."""
    return T / arb.pi() * ((T / arb.pi()) ** 2 + lead**2).sqrt()


def inverse(A):
    return np.array(arb_mat(A.tolist()).inv().tolist(), dtype=object)


def square(row):
    return np.outer(np.conj(row), row)


def sign(form):
    """Return 1 for a form that is positive definite, −1 for one that is not, 0 for neither: by the pivots of LDLᵀ."""
    F = (form + form.T) / 2
    while len(F):
        if not F[0, 0] > 0:
            return -1 if F[0, 0] < 0 else 0
        F = F[1:, 1:] - np.outer(F[1:, 0], F[1:, 0]) / F[0, 0]
    return 1


def stable(A):
    """Return 1 if all |z| < 1, because a power of A is small, or −1 if not, because its trace is above its size."""
    X = arb_mat(A.tolist())
    for _ in range(64):
        if sum(abs(entry) for entry in X.entries()) < 1:
            return 1
        if abs(X.trace()) > len(A):
            return -1
        X = X * X
    return 0


def positive(b, test=lambda x: 1 if x > 0 else -1 if x < 0 else 0):
    """Return the sign over [0, 1] of a polynomial of numbers or matrices, by its coefficients in Bernstein's basis."""
    pieces = [b]
    for _ in range(4000):
        if not pieces:
            return 1
        rows = [pieces.pop()]
        if (ends := min(test(rows[0][0]), test(rows[0][-1]))) != 1:  # values of the polynomial
            return ends
        if not all(test(x) == 1 for x in rows[0]):
            while len(rows[-1]) > 1:
                rows.append([(x + y) / 2 for x, y in itertools.pairwise(rows[-1])])
            pieces += [[row[0] for row in rows], [row[-1] for row in rows[::-1]]]
    return 0


def on_circle(A, B, C, D, form, poles=()):
    """Return the sign over all |z| = 1 of form(z, G), G = C (z − A)⁻¹ B + D, whose A is stable.

    Its determinant, times |det(z − A)|² and |z − p|⁴ of all poles p, is a polynomial in x = cos ω. Its degree is that
    of A, and two more for each pole. Where that is positive, the form has everywhere the sign that it has at z = −1.
    """
    chi: Any = arb_mat(A.tolist()).charpoly()
    markov, W = [], B
    for _ in A:
        markov.append(C @ W)
        W = A @ W
    parts: Any = [sum(chi[j] * markov[j - k - 1] for j in range(k + 1, len(A) + 1)) for k in range(len(A))]
    G = [[arb_poly([part[i, j] for part in parts]) + D[i, j] * chi for j in range(len(D.T))] for i in range(len(D))]

    def at(x):
        z = acb(x, (1 - x * x).sqrt())
        return z, form(z, np.array([[entry(z) / chi(z) for entry in row] for row in G]))

    def determinant(x):
        z, F = at(x)
        return (
            acb_mat(F.tolist()).det().real
            * abs(chi(z)) ** 2
            * math.prod([abs(z - p) ** 4 for p in poles], start=arb(1))
        )

    n = len(A) + 2 * len(poles)
    nodes = [(arb(2 * j + 1) / (2 * n + 2)).cos_pi().mid() for j in range(n + 1)]
    a = arb_poly.interpolate(nodes, [determinant(x) for x in nodes])(arb_poly([-1, 2])).coeffs()
    b = [sum(a[j] * math.comb(i, j) / math.comb(len(a) - 1, j) for j in range(i + 1)) for i in range(len(a))]
    return min(sign(np.vectorize(lambda x: x.real, otypes=[object])(at(arb(-1))[1])), positive(b))


def opened(loop, period, mismatch="B"):
    """Return A, B, C of a loop of q, q̇T and a controller's states, opened where a torque held for a period enters."""
    A, B, C, inputs = (ball(loop[name]) for name in ("A", "B", "C", mismatch))
    n, both = len(C), inputs.shape[1] > len(C)  # an acceleration's mean, or its first moment as well
    held = arb(period) ** 2 * np.array([[0.5, 1 / 12**0.5], [1, 0]] if both else [[0.5], [1]])
    expected = [np.kron(row, np.eye(n, dtype=int)) for row in held] + [ball(np.zeros((len(A) - 2 * n, len(inputs.T))))]
    close = abs(inputs - np.vstack(expected)) <= arb(period) ** 2 * 1e-12
    plant = A[: 2 * n] == np.eye(2 * n, len(A)) + np.eye(2 * n, len(A), n) * np.repeat([[1], [0]], n, axis=0)
    if not (np.all(close) and np.all(plant) and np.all(inputs[:, :n] == B)):
        raise ValueError("the states are not those of a double integrator under a torque that is held for the period")
    return A, B, C
