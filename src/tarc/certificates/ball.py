"""The robust ball: how far the inertia may be off, in any direction and changing at any time."""

from typing import Any

import numpy as np

from tarc import check
from tarc.certificates.base import JUDGES, Certificate, Witness, schur
from tarc.certificates.linear import Channel, alike, decouple
from tarc.certificates.norms import hinf_norm
from tarc.errors import TarcError
from tarc.laws.base import Law

Array = np.ndarray
Loop = tuple[Array, Array, Array, Array]

DIGITS = 1e-6


def ball(
    law: Law,
    centre: float | None = None,
    *,
    contains: tuple[float, float] | None = None,
    slope: float = 0.0,
    intersample: bool = True,
    computation_delay: int = 0,
) -> Certificate:
    """Certify the loop for every time-varying inertia ratio in a ball, in any number of joints at the cost of one.

    In coordinates M̂^½ q the joints' loops are identical and the mismatch is the symmetric E(q) = M̂^½ M(q)⁻¹ M̂^½. By
    the small-gain theorem the loop is stable for every E(t) with

        ‖E − ρ0 I‖ ≤ δ < 1/‖T‖∞,

    T the loop at ρ0 from an acceleration to v = M̂⁻¹τ. So the robot fits if the eigenvalues of M(q)⁻¹M̂ lie in
    [ρ0 − δ, ρ0 + δ]. With a slope, the robust term −κ(t) s, 0 ≤ κ(t) ‖P2‖ ≤ slope, varies at the same time: half of
    it goes into the loop, the other half into a second block of the mismatch, and a constant scaling between the two
    blocks is searched for.

    Parameters
    ----------
    law
        A law on time-delay estimation with scalar K1, K2 and P2.
    centre
        ρ0; None for the one that makes (ρ0 + δ)/(ρ0 − δ) largest.
    contains
        Instead of a centre: the range of ratios that the ball is to hold with the most room.
    slope
        Largest slope of the robust term [1/s²]; α ĉ ‖P2‖/ε for TARC.
    intersample
        Let E change within a period too (the lifted norm); False holds it constant over each period.
    computation_delay
        Periods between a measurement and its torque.

    Returns
    -------
    Certificate
        Its numbers: ``centre``, ``radius``, ``low`` and ``high`` ratio, ``ratio`` high/low. Certified for every ball of
        a radius above zero; with ``contains`` only if the ball holds the range, and inconclusive if not. The margin is
        the radius over the one that is needed, less 1; without ``contains`` it is the radius over the centre.

    Raises
    ------
    TarcError
        For gains that are not scalar, numbers out of range, a loop that is stable for no ratio.

    References
    ----------
    The small-gain theorem: G. Zames, IEEE Trans. Autom. Control 11(2), 1966. Lifting: B. Bamieh and J. B. Pearson,
    IEEE Trans. Autom. Control 37(4), 1992.
    """
    slope = check.number("slope", slope, 0)
    if contains is not None:
        low = check.number("contains", contains[0], 0, strict=True)
        contains = low, check.number("contains", contains[1], low)
    channels = decouple(law, computation_delay)
    if not alike(law):
        raise TarcError(
            "ball: the joints' gains differ or couple, and the ball needs the same on every joint; give one bandwidth "
            "and one damping for all"
        )
    parts = parts_of(channels[0], slope, intersample)
    centre = check.number("centre", best_centre(parts, contains) if centre is None else centre, 0, strict=True)
    scale, radius = best_scales(parts, centre)
    needed = 0.0 if contains is None else max(contains[1] - centre, centre - contains[0])
    matrices: dict[str, Array] = dict(zip(PARTS, parts, strict=True))
    numbers = {"centre": centre, "radius": radius, "needed": needed}
    numbers |= {} if scale is None else {"scale": scale}
    verdict, margin, witness = judge(matrices, numbers)
    numbers |= {"low": centre - radius, "high": centre + radius, "slope": slope, "period": law.period}
    if centre > radius:
        numbers["ratio"] = (centre + radius) / (centre - radius)
    ends = contains or (centre - radius, centre + radius)
    name = type(law).__name__
    return Certificate(
        kind="ball",
        claim=f"The loop of {name} around q̈ = E(t) M̂⁻¹τ is stable for every symmetric E(t) with eigenvalues from "
        f"{ends[0]:.5g} to {ends[1]:.5g}.",
        problem="‖T‖∞ δ < 1" if not slope else "‖[δ T_vv, d δ T_vs; T_sv k/2d, T_ss k/2]‖∞ < 1, k/2 in the loop",
        verdict=verdict,
        margin=margin,
        margin_meaning="radius over the centre" if contains is None else "radius over the one needed, less 1",
        assumptions=(
            "E changes at any time" if intersample else "E is constant within each period",
            f"the robust term is a slope between 0 and {slope:g} 1/s², which changes at any time"
            if slope
            else "there is no robust term",
            "the same gains, window, period and delay on every joint; no torque limit is reached, no sample lost",
            "Coriolis forces, gravity and friction disturb only",
            "H∞ norms are computed in floating point, to six digits from above",
            f"the torque reaches the joints {computation_delay} periods late and is held for a period",
        ),
        matrices=matrices,
        numbers=numbers,
        witness=witness,
    )


PARTS = ("free", "into", "out", "robust", "through", "acceleration", "share")
"""Of a loop that closes at any ratio: A(ρ) = free + ρ into out, W(ρ) = robust + ρ into through, v = out y + through w,
B for the mismatched acceleration, and k/2."""


def parts_of(channel: Channel, slope: float, intersample: bool) -> tuple[Array, ...]:
    """`PARTS` of a loop of one joint."""
    free, B, C, H, E = channel.around(0.0)
    T, wide = channel.period, B
    if intersample:
        # what an acceleration a(t) of unit mean square over the period can do to (q, q̇ T): a root of its Gramian
        gramian = T**4 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
        wide = np.zeros((len(free), 2))
        wide[:2] = np.linalg.cholesky(gramian)
    return free, B, C, H, E, wide, np.array([[slope / 2]])


def system(parts: tuple[Array, ...], ratio: float, weight: float = 0.0) -> Loop:
    """A, B, C, D of the loop at a ratio with half the slope in it, and the mismatch and the rest of the slope outside.

    From (a, w) to (v, weight q, s k/2): w and the last are there only with a slope, the middle one only with a weight.
    The mismatch maps (v, weight q) to a, where q stands for the stiffness of the robot itself, such as gravity's; a
    unit ball from s k/2 to w is the other half of the slope.
    """
    free, into, out, robust, through, wide, share = parts
    half = share.item()
    show = np.eye(1, len(free))
    W = robust + ratio * into @ through
    A = free + ratio * into @ out - half * W @ show
    columns, rows = [wide], [out - half * through @ show]
    if weight:
        rows.append(weight * show)
    if half:
        columns, rows = [*columns, W], [*rows, half * show]
    B, C = np.hstack(columns), np.vstack(rows)
    D = np.zeros((len(C), B.shape[1]))
    if half:
        D[0, wide.shape[1]] = through.item()
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

    Of v and q, each to an acceleration held as the torque is, to the mismatched acceleration and to w.
    """

    def __init__(self, parts: tuple[Array, ...]):
        free, into, out, robust, through, wide, share = parts
        z = np.exp(1j * _angles(free))[:, None, None]
        inputs = np.hstack([into, wide, robust])
        both = np.vstack([out, np.eye(1, len(free))])
        G = both @ np.linalg.solve(z * np.eye(len(free)) - free, inputs + 0 * z)
        G[:, 0, -1] += through.item()
        self.half = share.item()
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
        a, w = a * np.array([[1.0], [weight]]), w * np.array([1.0, weight])
        into, through = G[:, 1, :-1] * self.half, G[:, 1, -1] * self.half
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


def _angles(free: Array) -> Array:
    """Angles [rad a period] close enough for every peak: most of them low, and more beside poles near the circle.

    A literal law whose torque comes back after m periods has such poles at the m-th roots of one, and a narrow peak
    beside each.
    """
    poles = np.linalg.eigvals(free)
    turns = np.abs(np.angle(poles[np.abs(poles) > 0.9]))
    apart = np.geomspace(1e-8, 0.05, 80)
    beside = np.concatenate([-apart, apart])
    near = (turns[turns > 0.05][:, None] + beside).ravel()
    return np.unique(np.concatenate([np.geomspace(1e-4, np.pi, 300), near[near < np.pi]]))


def _greatest(v: Array, q: Array, mixed: Array) -> Array:
    """Greatest eigenvalue of [v mixed; conj(mixed) q], at least so great that its inverse is a number."""
    return np.maximum((v + q) / 2 + np.sqrt((v - q) ** 2 / 4 + np.abs(mixed) ** 2), 1e-300)


def best_scales(parts: tuple[Array, ...], centre: float, weight: float = 0.0) -> tuple[float | None, float]:
    """Scale of the slope's block, None without a slope, and the largest radius that is certified; zero for none."""
    loop = system(parts, centre, weight)
    sloping = bool(parts[-1].item())
    if schur(loop[0])[0] != "certified":
        return (1.0 if sloping else None), 0.0
    if not sloping:
        return None, (1 - DIGITS) / hinf_norm(*loop)
    scale, radius = Responses(parts).best(centre, weight)
    for less in (2e-5, 2e-4, 2e-3, 0.01, 0.03, 0.08, 0.2, 0.4):  # the grid of frequencies may have missed a peak
        trial = radius * (1 - less)
        if trial > 0 and hinf_norm(*weighed(loop, trial, scale)) < 1:
            return scale, trial
    return scale, 0.0


def best_centre(parts: tuple[Array, ...], contains: tuple[float, float] | None) -> float:
    """The centre whose ball has the largest ratio of its ends, or holds a range with the most room."""
    from scipy.optimize import minimize_scalar

    responses = Responses(parts)

    def worth(log: float) -> float:
        centre = float(np.exp(log))
        spectral_radius = float(np.max(np.abs(np.linalg.eigvals(system(parts, centre)[0]))))
        if spectral_radius >= 1:
            return -spectral_radius
        radius = responses.best(centre)[1]
        if contains is None:
            return radius / centre
        return radius / max(contains[1] - centre, centre - contains[0], 1e-12)

    if contains is None:
        logs = np.log(np.geomspace(1e-4, 10.0, 33))
    else:
        logs = np.log(np.linspace(*contains, 9)) if contains[1] > contains[0] else np.log(np.array(contains[:1]))
    values = [worth(log) for log in logs]
    top = int(np.argmax(values))
    if values[top] <= 1e-3:  # nothing, or what rounding leaves of a mode on the circle
        if contains is None:
            raise TarcError(
                "ball: no inertia ratio makes this loop stable; use a shorter window, a lower bandwidth, a smaller "
                "slope or less computation delay"
            )
        return float(np.exp(logs[top]))
    ends = logs[max(top - 1, 0)], logs[min(top + 1, len(logs) - 1)]
    if ends[0] == ends[1]:
        return float(np.exp(logs[top]))
    found: Any = minimize_scalar(lambda log: -worth(log), bounds=ends, method="bounded", options={"xatol": 1e-4})
    return float(np.exp(found.x if -found.fun > values[top] else logs[top]))


def judge(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict and margin from the stored matrices alone: the norm below one, and the radius enough."""
    centre, radius, needed = numbers["centre"], numbers["radius"], numbers["needed"]
    weight, scale = numbers.get("weight", 0.0), numbers.get("scale")
    given = [centre, radius, needed, weight, 1.0 if scale is None else scale]
    if not np.all(np.isfinite(given)) or not centre > 0 or scale == 0:
        return "inconclusive", 0.0, None
    loop = system(tuple(matrices[name] for name in PARTS), centre, weight)
    margin = radius / max(needed, centre / 1e3) - 1 if needed else radius / centre
    sound = radius > 0 and schur(loop[0])[0] == "certified"
    sound = sound and hinf_norm(*weighed(loop, radius, scale)) < 1 and radius >= needed
    return ("certified" if sound else "inconclusive"), float(margin), None


JUDGES["ball"] = judge
