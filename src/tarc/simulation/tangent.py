"""Derivatives of a whole run with respect to its start and inputs, by the forward mode."""

from typing import NamedTuple, Self

import casadi as ca
import numpy as np

from tarc.core.types import Array
from tarc.simulation.casadi_backend import interpreted


class Trajectory(NamedTuple):
    """Start and inputs of a run: state vector (s,), and one row of inputs per period (k, u)."""

    state: Array
    rows: Array

    def direction(self, other: Self, step: float) -> "Trajectory":
        """Return the change to another run per unit of a parameter; zero where a sample is lost."""
        with np.errstate(invalid="ignore"):
            rows = (other.rows - self.rows) / step
        return Trajectory((other.state - self.state) / step, np.where(np.isfinite(rows), rows, 0.0))


def position_derivatives(
    function: ca.Function, n_joints: int, run: Trajectory, directions: list[Trajectory]
) -> tuple[Array, Array]:
    """Return the positions of a run and their derivatives along directions.

    With x⁺ = f(x, u) and y = g(x, u), each direction (δx₀, δu_k) is carried along with the run:

        δx⁺ = ∂f/∂x δx + ∂f/∂u δu,    δy = ∂g/∂x δx + ∂g/∂u δu

    A quantiser has the derivative zero. So the derivative of a quantised loop is that of a loop without feedback, which
    is of no use. Where a law compares (a sign, a maximum), the derivative is that of the branch that runs.

    Parameters
    ----------
    function
        One period of the closed loop, [x, u] -> [x⁺, y], whose first outputs are the positions.
    n_joints
        Number of positions.
    run
        Where to take the derivative.
    directions
        Changes of start and inputs per unit of a parameter, d of them.

    Returns
    -------
    positions
        Of the joints [rad or m], shape (k, n).
    derivatives
        Of the positions along each direction, shape (k, n, d).
    """
    n, count = n_joints, len(directions)
    x, u = ca.SX.sym("x", function.nnz_in(0)), ca.SX.sym("u", function.nnz_in(1))
    x_next, y = function(x, u)
    x_change, u_change = ca.SX.sym("x_change", x.numel(), count), ca.SX.sym("u_change", u.numel(), count)
    changes = ca.jtimes(ca.vertcat(x_next, y[:n]), ca.vertcat(x, u), ca.vertcat(x_change, u_change))
    inputs = [ca.vertcat(x, ca.vec(x_change)), ca.vertcat(u, ca.vec(u_change))]
    x_next_change, y_change = changes[: x.numel(), :], changes[x.numel() :, :]
    outputs = [ca.vertcat(x_next, ca.vec(x_next_change)), ca.vertcat(y[:n], ca.vec(y_change))]
    tangent = ca.Function("tangent", inputs, [ca.densify(one) for one in outputs], ["x", "u"], ["x_next", "y"])
    start = np.concatenate([run.state, *(direction.state for direction in directions)])
    rows = np.hstack([run.rows, *(direction.rows for direction in directions)])
    result = interpreted(tangent, start)(rows)
    return result[:, :n], result[:, n:].reshape(len(rows), count, n).transpose(0, 2, 1)


def log_error_gradient(positions: Array, derivatives: Array, reference: Array, reference_derivatives: Array) -> Array:
    """Return the gradient of the logarithm of the RMS error, shape (d,).

        ∂ log √(mean e²) = Σ e ∂e / Σ e²,    e = q − q_d

    Parameters
    ----------
    positions, derivatives
        As `position_derivatives` returns them, over the samples that count.
    reference, reference_derivatives
        q_d and its derivatives, of the same shapes.
    """
    error = positions - reference
    changes = derivatives - reference_derivatives
    return np.einsum("kn,knd->d", error, changes) / np.sum(error**2)
