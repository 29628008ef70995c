"""The loop of one joint around an uncertain inertia: its matrices and its frequency responses."""

from typing import NamedTuple

import numpy as np

from tarc.analysis.linearise import Channel
from tarc.core.types import Array
from tarc.numerics.interval_minimum import minimise_in_interval

System = tuple[Array, Array, Array, Array]
"""A, B, C, D of a discrete-time system."""


class UncertainLoop(NamedTuple):
    """A loop that closes at any inertia ratio ρ, with robust term w and mismatched acceleration a.

        A(ρ) = A + ρ B C,     W(ρ) = B_robust + ρ B D_robust,     v = C y + D_robust w

    Attributes
    ----------
    A, B, C
        The loop opened at its inertia ratio.
    B_robust, D_robust
        What the robust term w adds to the state and to v.
    B_mismatch
        Input matrix of the mismatched acceleration.
    half_slope
        k/2, half of the largest slope of the robust term [1/s²], shape (1, 1).
    lead_periods
        θ/T, by which the velocity counts beside the position [periods], shape (1, 1).
    """

    A: Array
    B: Array
    C: Array
    B_robust: Array
    D_robust: Array
    B_mismatch: Array
    half_slope: Array
    lead_periods: Array

    @classmethod
    def from_channel(
        cls, channel: Channel, slope: float, intersample: bool, lead_periods: float = 0.0
    ) -> "UncertainLoop":
        """Return the loop of one joint.

        Parameters
        ----------
        channel
            The linearised loop.
        slope
            Largest slope k of the robust term [1/s²].
        intersample
            Whether the mismatch may change within a period.
        lead_periods
            θ/T [periods].
        """
        A, B, C, B_robust, D_robust = channel.closed_loop(0.0)
        T, B_mismatch = channel.period, B
        if intersample:
            # what an acceleration a(t) of unit mean square over the period can do to (q, q̇ T): its mean, as the
            # torque's, and the other column of a root of its Gramian, T⁴ [1/3 1/2; 1/2 1]
            B_mismatch = np.zeros((len(A), 2))
            B_mismatch[:2] = T**2 * np.array([[1 / 2, 1 / 12**0.5], [1.0, 0.0]])
        return cls(A, B, C, B_robust, D_robust, B_mismatch, np.array([[slope / 2]]), np.array([[lead_periods]]))

    def with_past_position(self, periods: int) -> "UncertainLoop":
        """Return the loop with the last positions as further states; the last state is q some periods ago.

        Parameters
        ----------
        periods
            Number of periods; for zero the loop stays as it is.
        """
        if periods == 0:
            return self
        n = len(self.A)
        A = np.zeros((n + periods, n + periods))
        A[:n, :n] = self.A
        A[n, 0] = 1.0
        A[n + 1 :, n:-1] = np.eye(periods - 1)
        padding = np.zeros((periods, 1))
        return self._replace(
            A=A,
            B=np.concatenate([self.B, padding]),
            C=np.concatenate([self.C, padding.T], axis=1),
            B_robust=np.concatenate([self.B_robust, padding]),
            B_mismatch=np.concatenate([self.B_mismatch, np.zeros((periods, self.B_mismatch.shape[1]))]),
        )

    def closed_loop(self, ratio: float, position_weight: float = 0.0, growth: float = 1.0) -> System:
        """Return A, B, C, D at a ratio, with half of the slope in the loop and the uncertainty outside.

        The system maps (a, w) to (v, η q, η θ q̇, s k/2). The mismatch maps the first three back to a, where q and its
        change over a period stand for the robot's stiffness and damping. A unit ball from s k/2 to w is the other half
        of the slope.

        Parameters
        ----------
        ratio
            ρ.
        position_weight
            η [1/s²]. Without it the outputs η q and η θ q̇ are left out; without a slope w and s k/2.
        growth
            Factor g on states and inputs in each period. Signals times g^k obey this system, so that what holds for it
            shows that errors decay as g^−k.
        """
        half, lead = self.half_slope.item(), self.lead_periods
        position = np.eye(1, len(self.A))
        B_robust = self.B_robust + ratio * self.B @ self.D_robust
        A = self.A + ratio * self.B @ self.C - half * B_robust @ position
        columns, rows = [self.B_mismatch], [self.C - half * self.D_robust @ position]
        if position_weight:
            rows.append(position_weight * position)
            if lead.item():
                rows.append(position_weight * lead * (A[:1] - position))
        if half:
            columns, rows = [*columns, B_robust], [*rows, half * position]
        B, C = np.hstack(columns), np.vstack(rows)
        D = np.zeros((len(C), B.shape[1]))
        if half:
            D[0, self.B_mismatch.shape[1]] = self.D_robust.item()
        if position_weight and lead.item():
            D[2] = position_weight * lead * B[0]
        return growth * A, growth * B, C, D


def scaled_system(system: System, radius: float, scale: float | None = None) -> System:
    """Return the system whose H∞ norm must be below one.

    The outputs to the mismatch are multiplied by the radius. The scale divides s k/2 and multiplies w.
    """
    A, B, C, D = system
    rows, columns = np.full(len(C), radius), np.ones(B.shape[1])
    if scale is not None:
        rows[-1], columns[-1] = 1 / scale, scale
    return A, B * columns, C * rows[:, None], D * rows[:, None] * columns


class FrequencyResponses:
    """Frequency responses of the open loop, from which those at any ratio follow without its matrices.

    Attributes
    ----------
    angles
        ω T [rad], shape (f,). With a centre there are more beside the poles of the loop there.
    half_slope
        k/2 [1/s²].
    lead_factor
        |1 + θ (z − 1)/T| as √(1 + |θ (z − 1)/T|²), shape (f, 1).
    from_torque, from_mismatch, from_robust
        Responses of (v, q) to an acceleration held over the period, to the mismatched one, and to w. Shapes (f, 2),
        (f, 2, 1 or 2) and (f, 2).
    """

    def __init__(self, loop: UncertainLoop, centre: float | None = None, count: int = 300):
        A = loop.A
        self.angles = _angles(A, count)
        if centre is not None:
            self.angles = np.unique(np.concatenate([self.angles, _peak_angles(loop.closed_loop(centre)[0])]))
        z = np.exp(1j * self.angles)[:, None, None]
        inputs = np.hstack([loop.B, loop.B_mismatch, loop.B_robust])
        outputs = np.vstack([loop.C, np.eye(1, len(A))])
        G = outputs @ np.linalg.solve(z * np.eye(len(A)) - A, inputs + 0 * z)
        G[:, 0, -1] += loop.D_robust.item()
        self.half_slope = loop.half_slope.item()
        self.lead_factor = np.sqrt(1 + np.abs(loop.lead_periods * (z[:, 0] - 1)) ** 2)
        self.from_torque, self.from_mismatch, self.from_robust = G[:, :, 0], G[:, :, 1:-1], G[:, :, -1]

    def at_ratio(self, ratio: float) -> Array:
        """Return the response from (a, w) to (v, q), shape (f, 2, 2 or 3), with k/2 in the loop."""
        inputs = np.concatenate([self.from_mismatch, self.from_robust[:, :, None]], axis=2)
        feedback = np.zeros((len(inputs), 2, 2), dtype=complex)
        feedback[:, :, 0], feedback[:, :, 1] = ratio * self.from_torque, -self.half_slope * self.from_robust
        return np.linalg.solve(np.eye(2) - feedback, inputs)

    def best_scale(self, ratio: float, position_weight: float = 0.0) -> tuple[float, float]:
        """Return the scale of the slope's block and the radius that it admits on the grid of frequencies.

        With P from (a, w) to (v, η q) and s the row to s k/2, scaled, r² PᴴP + sᴴs < 1 at each frequency. So 1/r² is
        the largest eigenvalue of the 2 × 2 matrix P (1 − sᴴs)⁻¹ Pᴴ.
        """

        G = self.at_ratio(ratio)
        a, w = G[:, :, :-1], G[:, :, -1]
        s_a, s_w = G[:, 1, :-1] * self.half_slope, G[:, 1, -1] * self.half_slope
        weights = np.hstack([np.ones_like(self.lead_factor), position_weight * self.lead_factor])
        a, w = a * weights[:, :, None], w * weights
        vv, qq = np.sum(np.abs(a) ** 2, axis=2).T
        vq = np.sum(a[:, 0] * a[:, 1].conj(), axis=1)
        if not self.half_slope:
            return 1.0, float(1 / np.sqrt(np.max(_max_eigenvalue(vv, qq, vq))))
        ss_a, ss_w = np.sum(np.abs(s_a) ** 2, axis=1), np.abs(s_w) ** 2
        cross_a, cross_w = np.sum(a * s_a.conj()[:, None], axis=2), w * s_w.conj()[:, None]

        def radius(log_scale: float) -> float:
            d2 = np.exp(2 * log_scale)
            beta = ss_a / d2 + ss_w
            if np.max(beta) >= 1:
                return 1 - float(np.max(beta))
            cross = cross_a / np.sqrt(d2) + cross_w * np.sqrt(d2)
            v, q = (np.abs(cross) ** 2 / (1 - beta)[:, None]).T
            mixed = cross[:, 0] * cross[:, 1].conj() / (1 - beta)
            v, q = vv + d2 * np.abs(w[:, 0]) ** 2 + v, qq + d2 * np.abs(w[:, 1]) ** 2 + q
            mixed = vq + d2 * w[:, 0] * w[:, 1].conj() + mixed
            return float(1 / np.sqrt(np.max(_max_eigenvalue(v, q, mixed))))

        least = 0.5 * np.log(max(np.max(ss_a / np.maximum(1 - ss_w, 1e-12)), 1e-300))  # below it, beta exceeds one
        log_scale, value = minimise_in_interval(lambda log_scale: -radius(log_scale), least, least + 12, 1e-3)
        return float(np.exp(log_scale)), max(-value, 0.0)


def _angles(A: Array, count: int) -> Array:
    """Return angles [rad per period] close enough for every peak: most are low, more lie beside poles near the circle.

    A law that feeds its torque back after m periods has poles at the m-th roots of one, with a narrow peak beside each.
    """
    poles = np.linalg.eigvals(A)
    pole_angles = np.abs(np.angle(poles[np.abs(poles) > 0.9]))
    distances = np.geomspace(1e-8, 0.05, count // 4)
    offsets = np.concatenate([-distances, distances])
    near = (pole_angles[pole_angles > 0.05][:, None] + offsets).ravel()
    return np.unique(np.concatenate([np.geomspace(1e-4, np.pi, count), near[near < np.pi]]))


def _peak_angles(A: Array) -> Array:
    """Return angles about the peaks of a closed loop that are too narrow for the grid of `_angles`."""
    poles = np.linalg.eigvals(A)
    pole_angles, widths = np.abs(np.angle(poles)), 1 - np.abs(poles)
    narrow = (widths > 0) & (widths < 0.05 * np.maximum(pole_angles, 2e-3))
    distances = np.geomspace(0.05, 20.0, 25)
    near = pole_angles[narrow, None] + widths[narrow, None] * np.concatenate([-distances, [0.0], distances])
    return near[(near > 0) & (near < np.pi)]


def _max_eigenvalue(v: Array, q: Array, mixed: Array) -> Array:
    """Return the largest eigenvalue of [v mixed; conj(mixed) q], at least 1e-300 so that its inverse is finite."""
    return np.maximum((v + q) / 2 + np.sqrt((v - q) ** 2 / 4 + np.abs(mixed) ** 2), 1e-300)
