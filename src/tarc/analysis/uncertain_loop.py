"""The loop of one joint around an inertia that is off: its matrices, the mismatch outside, and its responses."""

from typing import Any, NamedTuple

import numpy as np

from tarc.analysis.linearise import Channel
from tarc.core.types import Array

Loop = tuple[Array, Array, Array, Array]


class Parts(NamedTuple):
    """Of a loop that closes at any ratio: A(ρ) = free + ρ into out, W(ρ) = robust + ρ into through.

    v = out y + through w; then B for the mismatched acceleration, k/2, and the lead, by which the velocity counts
    beside the position [periods].
    """

    free: Array
    into: Array
    out: Array
    robust: Array
    through: Array
    acceleration: Array
    share: Array
    lead: Array


def parts_of(channel: Channel, slope: float, intersample: bool, lead: float = 0.0) -> Parts:
    """`Parts` of a loop of one joint."""
    free, B, C, H, E = channel.around(0.0)
    T, wide = channel.period, B
    if intersample:
        # what an acceleration a(t) of unit mean square over the period can do to (q, q̇ T): its mean, as the torque's,
        # and the rest of a root of its Gramian, T⁴ [1/3 1/2; 1/2 1]
        wide = np.zeros((len(free), 2))
        wide[:2] = T**2 * np.array([[1 / 2, 1 / 12**0.5], [1.0, 0.0]])
    return Parts(free, B, C, H, E, wide, np.array([[slope / 2]]), np.array([[lead]]))


def system(parts: Parts, ratio: float, weight: float = 0.0) -> Loop:
    """A, B, C, D of the loop at a ratio with half the slope in it, and the mismatch and the rest of the slope outside.

    From (a, w) to (v, weight q, weight lead T q̇, s k/2): w and the last are there only with a slope, those between only
    with a weight, the second of them only with a lead. The mismatch maps (v, weight q, weight lead T q̇) to a, where q
    and its change over the period, q̇ T, stand for the stiffness and the damping of the robot itself, such as gravity's;
    a unit ball from s k/2 to w is the other half of the slope.
    """
    free, into, out, robust, through, wide, share, lead = parts
    half = share.item()
    show = np.eye(1, len(free))
    W = robust + ratio * into @ through
    A = free + ratio * into @ out - half * W @ show
    columns, rows = [wide], [out - half * through @ show]
    if weight:
        rows.append(weight * show)
        if lead.item():
            rows.append(weight * lead * (A[:1] - show))
    if half:
        columns, rows = [*columns, W], [*rows, half * show]
    B, C = np.hstack(columns), np.vstack(rows)
    D = np.zeros((len(C), B.shape[1]))
    if half:
        D[0, wide.shape[1]] = through.item()
    if weight and lead.item():
        D[2] = weight * lead * B[0]
    return A, B, C, D


def weighed(loop: Loop, radius: float, scale: float | None = None) -> Loop:
    """The system whose norm must be below one: outputs to the mismatch times the radius, the slope's block scaled."""
    A, B, C, D = loop
    rows, columns = np.full(len(C), radius), np.ones(B.shape[1])
    if scale is not None:
        rows[-1], columns[-1] = 1 / scale, scale
    return A, B * columns, C * rows[:, None], D * rows[:, None] * columns


class Responses:
    """Frequency responses of the loop left open, from which those at any ratio follow without its matrices.

    Of v and q, each to an acceleration held as the torque is, to the mismatched acceleration and to w. With a centre
    there are more frequencies, beside the poles of the loop there. The count is that of those spread evenly.
    """

    def __init__(self, parts: Parts, centre: float | None = None, count: int = 300):
        free, into, out, robust, through, wide, share, lead = parts
        self.angles = _angles(free, count)
        if centre is not None:
            self.angles = np.unique(np.concatenate([self.angles, _beside(system(parts, centre)[0])]))
        z = np.exp(1j * self.angles)[:, None, None]
        inputs = np.hstack([into, wide, robust])
        both = np.vstack([out, np.eye(1, len(free))])
        G = both @ np.linalg.solve(z * np.eye(len(free)) - free, inputs + 0 * z)
        G[:, 0, -1] += through.item()
        self.half = share.item()
        self.swing = np.sqrt(1 + np.abs(lead * (z[:, 0] - 1)) ** 2)
        self.held, self.mismatch, self.robust = G[:, :, 0], G[:, :, 1:-1], G[:, :, -1]

    def at(self, ratio: float) -> Array:
        """Response from (a, w) to (v, q), shape (frequencies, 2, 2 or 3), with k/2 in the loop."""
        inputs = np.concatenate([self.mismatch, self.robust[:, :, None]], axis=2)
        loop = np.zeros((len(inputs), 2, 2), dtype=complex)
        loop[:, :, 0], loop[:, :, 1] = ratio * self.held, -self.half * self.robust
        return np.linalg.solve(np.eye(2) - loop, inputs)

    def best(self, ratio: float, weight: float = 0.0) -> tuple[float, float]:
        """Scale of the slope's block, and radius that the responses at a ratio admit, up to the grid of frequencies.

        With P from (a, w) to (v, weight q) and s the row to s k/2, scaled, r² PᴴP + sᴴs < 1 at each frequency, so that
        1/r² is the greatest eigenvalue of the 2 × 2 matrix P (1 − sᴴs)⁻¹ Pᴴ.
        """
        G = self.at(ratio)
        a, w = G[:, :, :-1], G[:, :, -1]
        into, through = G[:, 1, :-1] * self.half, G[:, 1, -1] * self.half
        size = np.hstack([np.ones_like(self.swing), weight * self.swing])
        a, w = a * size[:, :, None], w * size
        vv, qq = np.sum(np.abs(a) ** 2, axis=2).T
        vq = np.sum(a[:, 0] * a[:, 1].conj(), axis=1)
        if not self.half:
            return 1.0, float(1 / np.sqrt(np.max(_greatest(vv, qq, vq))))
        ss, tt = np.sum(np.abs(into) ** 2, axis=1), np.abs(through) ** 2
        cross_a, cross_w = np.sum(a * into.conj()[:, None], axis=2), w * through.conj()[:, None]

        def radius(log: float) -> float:
            d2 = np.exp(2 * log)
            beta = ss / d2 + tt
            if np.max(beta) >= 1:
                return 1 - float(np.max(beta))
            cross = cross_a / np.sqrt(d2) + cross_w * np.sqrt(d2)
            v, q = (np.abs(cross) ** 2 / (1 - beta)[:, None]).T
            mixed = cross[:, 0] * cross[:, 1].conj() / (1 - beta)
            v, q = vv + d2 * np.abs(w[:, 0]) ** 2 + v, qq + d2 * np.abs(w[:, 1]) ** 2 + q
            mixed = vq + d2 * w[:, 0] * w[:, 1].conj() + mixed
            return float(1 / np.sqrt(np.max(_greatest(v, q, mixed))))

        from scipy.optimize import minimize_scalar

        least = 0.5 * np.log(max(np.max(ss / np.maximum(1 - tt, 1e-12)), 1e-300))  # below it, beta exceeds one
        found: Any = minimize_scalar(
            lambda log: -radius(log), bounds=(least, least + 12), method="bounded", options={"xatol": 1e-3}
        )
        return float(np.exp(found.x)), max(-float(found.fun), 0.0)


def _angles(free: Array, count: int) -> Array:
    """Angles [rad a period] close enough for every peak: most of them low, and more beside poles near the circle.

    A literal law whose torque comes back after m periods has such poles at the m-th roots of one, and a narrow peak
    beside each.
    """
    poles = np.linalg.eigvals(free)
    turns = np.abs(np.angle(poles[np.abs(poles) > 0.9]))
    apart = np.geomspace(1e-8, 0.05, count // 4)
    beside = np.concatenate([-apart, apart])
    near = (turns[turns > 0.05][:, None] + beside).ravel()
    return np.unique(np.concatenate([np.geomspace(1e-4, np.pi, count), near[near < np.pi]]))


def _beside(closed: Array) -> Array:
    """Angles about the peaks of a closed loop that are too narrow for the grid of `_angles`."""
    poles = np.linalg.eigvals(closed)
    turns, widths = np.abs(np.angle(poles)), 1 - np.abs(poles)
    narrow = (widths > 0) & (widths < 0.05 * np.maximum(turns, 2e-3))
    apart = np.geomspace(0.05, 20.0, 25)
    near = turns[narrow, None] + widths[narrow, None] * np.concatenate([-apart, [0.0], apart])
    return near[(near > 0) & (near < np.pi)]


def _greatest(v: Array, q: Array, mixed: Array) -> Array:
    """Greatest eigenvalue of [v mixed; conj(mixed) q], at least so great that its inverse is a number."""
    return np.maximum((v + q) / 2 + np.sqrt((v - q) ** 2 / 4 + np.abs(mixed) ** 2), 1e-300)
