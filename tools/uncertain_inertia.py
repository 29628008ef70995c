"""Certificates of an inertia that varies: balls of E = M̂^½ M⁻¹ M̂^½, Lyapunov functions affine in E⁻¹, robots."""

import itertools
import math
from typing import Any

import numpy as np
from flint import acb, arb, arb_mat

from ball_arithmetic import (
    LEAST,
    LOOSE,
    ROOM,
    ball,
    inverse,
    on_circle,
    opened,
    positive,
    sign,
    square,
    stable,
    symmetric,
    within_period,
)

FORM = "torque", "energy", "power", "position", "velocity"
MEAN_SQUARES = [[120, 60, 20], [60, 40, 15], [20, 15, 6]], [[0, 0, 0], [0, 6, 3], [0, 3, 2]]


def tolerates(b, period, slope, growth: Any = 1):
    """Decide whether the loop is stable for all E(t) of a ball, with its stiffness, its change and all slopes κ(t).

    With v = M̂⁻¹τ, b = E v and d the acceleration by stiffness, a = b − d − ρ0 v is bounded by radius and η; d by the
    stiffness σ, and by σg(ρ0 + δ)|(v, ηx, ηθẋ)| as the acceleration moves x within a period; w by the slope; and
    Σ y_m (v(k+m)·b(k) − v(k)·b(k+m)) is bounded since E⁻¹ is symmetric and slow. The states may grow by a factor in
    each period, for a norm that follows M̂(q).
    """
    loop, change, proof = b["loop"], b["max_change"], b["multiplier"] or {}
    (A, B, C), mismatch, T = opened(loop, period, "B_mismatch"), ball(loop["B_mismatch"]), arb(period)
    robust, direct, half, lead = (ball(loop[name]) for name in ("B_robust", "D_robust", "half_slope", "lead_periods"))
    centre, radius, eta, sigma = (arb(b[name]) for name in ("centre", "radius", "position_weight", "stiffness"))
    half, lead, n, q, scale = half[0, 0], lead[0, 0], len(mismatch.T), ball(np.eye(1, len(A))), arb(b["scale"] or 1)
    weight, forces, decays, gains, penalty = 1 / scale**2, arb(0), [], [], arb(0)
    if change is not None:
        change, weight, forces = arb(change) * LOOSE, arb(proof["slope"]), arb(proof["stiffness"])
        decays, gains = ball(proof["decays"]), ball(proof["coefficients"])
        turned = 1 / (1 - change * (centre + radius))  # of ‖E(t) Ē⁻¹‖ in a period, with its mean Ē
        penalty = sum(
            (2 * change * turned**2 * abs(c) * p / (1 - p) ** 2 for p, c in zip(decays, gains, strict=True)), penalty
        )
        if not (change >= 0 and 0 < turned < 3 and radius <= centre and all(0 < p < 1 for p in decays)):
            return -1
    has_forces = change is not None and eta > 0 and sigma > 0
    ranges = 2 * half == slope, centre > 0, radius > 0, weight > 0, forces > 0 or not has_forces
    if not all(ranges) or not all(x >= 0 for x in (eta, sigma, half, lead)):
        return -1
    entry = robust + centre * B @ direct
    v, X = C - half * direct @ q, A + centre * B @ C - half * entry @ q
    D = ball(np.zeros((2, n + 1)))
    D[0, n] = direct[0, 0]
    kept = [*range(n), *[n] * (half > 0), *[n + 1] * has_forces]

    def form(z, G):
        G, unit, moved = np.hstack([G, 0 * G[:, :1]]), np.eye(n + 2, dtype=int), 1 + abs(lead * (z / growth - 1)) ** 2
        moved_by = centre * G[0] + unit[0] + unit[n + 1]
        y = sum((c * p / (z - p) for p, c in zip(decays, gains, strict=True)), acb(0))
        mixed = (y - y.conjugate()) * np.outer(np.conj(G[0]), moved_by)
        F = (
            np.diag(np.array([acb(1)] * n + [acb(weight), acb(forces)]))
            - radius**2 * square(G[0])
            - penalty * square(moved_by)
        )
        of_both = 21 * (LOOSE * sigma * within_period(lead * T, T) * (centre + radius)) ** 2 * has_forces
        of_position = (arb(21) / 20 * (LOOSE * sigma) ** 2 + of_both * eta**2) * moved
        F = F - forces * of_both * square(G[0])
        size = (radius * eta) ** 2 * moved + forces * of_position + weight * half**2
        return (F - size * square(G[1]) - mixed - np.conj(mixed.T))[np.ix_(kept, kept)]

    found, columns = stable(X * growth), np.hstack([mismatch, entry]) * growth
    return found if found != 1 else on_circle(X * growth, columns, np.vstack([v, q]), D, form, decays)


def varying_ratio(e, witness):
    b = e["ball"]
    rate = "" if b["max_change"] is None else f" and E⁻¹ changing by at most {b['max_change'] / e['period']:.6g} 1/s"
    rate += "" if len(b["loop"]["B_mismatch"][0]) == 2 else ", constant within each period"
    text = f"stable for all E(t) with {b['centre'] - b['radius']:.6g} ≤ E ≤ {b['centre'] + b['radius']:.6g}{rate}"
    text += decaying(b["growth"], e["period"], f" up to a radius of {b['decay_radius']:.6g}")
    fits = b["radius"] >= e["needed_radius"] and not witness
    return min(tolerates(b, e["period"], e["slope"]), decays(b, e)) if fits else -1, text


def decaying(growth, T, addition=""):
    """Return in words how errors decay."""
    return f"; errors decay by exp(−{math.log(growth) / T:.4g} t){addition}" if growth > 1 else ""


def decays(b, e):
    """Decide whether errors decay in a part of a ball, if it says so."""
    growth, radius = b["growth"], b["decay_radius"]
    if growth == 1:
        return 1
    if not (growth > 1 and e.get("needed_radius", 0) <= radius <= b["radius"]):
        return -1
    return tolerates(b | {"radius": radius}, e["period"], e["slope"], arb(growth))


def at_rest(loop, point, nominal, T, witness):
    """Decide whether a mode grows, as the witness says, of the robot that is held at rest at a point."""
    rate, text = witness["growth_rate"] * T * 0.999, f"a mode grows at rest at q = {witness['posture']}"
    if rate <= 0 or point["velocity"] is not None or point["position"] != witness["posture"]:
        return -1, text
    M, D, G, N = symmetric(point["inertia"]), *(ball(x) for x in (point["damping"], point["stiffness"], nominal))
    n = len(M)
    rates = np.hstack([-inverse(M) @ G, -inverse(M) @ D / T, inverse(M) @ N]) * T
    motion = np.vstack([np.hstack([0 * M, np.eye(n, dtype=int), 0 * M]), rates * arb(T), ball(np.zeros((n, 3 * n)))])
    moved = np.array(arb_mat(motion.tolist()).exp().tolist(), dtype=object)[: 2 * n]
    A, _, C = (np.kron(X, np.eye(1 if len(loop["C"]) == n > 1 else n, dtype=int)) for X in opened(loop, T))
    A[: 2 * n] = moved[:, 2 * n :] @ C
    A[: 2 * n, : 2 * n] += moved[:, : 2 * n]
    return -stable(A / arb(rate).exp()), text


def force(point, W, lead):
    """Return G W Gᵀ + D W Dᵀ/θ²; it is infinite for a damping without a lead time θ."""
    return stiff(ball(point["stiffness"]), ball(point["damping"]), W, lead)


def stiff(G, D, W, lead):
    return G @ W @ G.T + (D @ W @ D.T / lead**2 if lead > 0 else ball(np.where(D == 0, 0, np.inf)))


def contained(point, N, W, b, T, own=0):
    """Return whether |[E − ρ0, H/η, C/(ηθ)]| is below a radius with 5 % more of E or 1/E, of H and of C.

    Since x(t) = x + tẋ in a period, C becomes C + HT at its end, where the law's own stiffness does not move. Beyond
    this the acceleration adds to x and ẋ, so that the norm must be below δ(1 − g) − gρ0, g = sup|[H, C/θ]| within.
    """
    M, (centre, radius, eta, lead, stiffness) = symmetric(point["inertia"]), b
    within = stiffness * within_period(lead, T)
    below = radius * (1 - within) - within * centre
    dampings = [ball(point["damping"]) + arb(time) * (ball(point["stiffness"]) + own) for time in (0, T)]
    parts, size, found = [ratio * N - centre * M for ratio in (arb(ROOM), 1 / arb(ROOM))], M @ W @ M, []
    for damping in dampings:
        forces = stiff(ball(point["stiffness"]), damping, W, lead) * arb(ROOM) ** 2
        found.append(sign((LOOSE * stiffness) ** 2 * size + LEAST * size - forces))
        found += [sign(below**2 * size - R @ W @ R - forces / eta**2) for R in parts]
    return min(found) if below > 0 else -1


def changes(point):
    """Yield the extreme dM/dt of a point, up to their sign and more."""
    slopes = [symmetric(x) * v for x, v in zip(point["inertia_slopes"], ball(point["velocity_limits"]), strict=True)]
    for signs in itertools.product((1, -1), repeat=len(slopes)):
        yield sum((one * slope for one, slope in zip(signs, slopes, strict=True)), 0 * slopes[0])


def within_form(form, point, N, W):
    """Return whether α0|k|² + α1kᵀEk + 2α2ẋᵀk ≤ β0|x|² + β1|ẋ|² with 5 % more of k and E, in q: k is τ = −Gq − Dq̇."""
    if not form:
        return 1
    torque, energy, power, position, velocity = (arb(form[x]) for x in FORM)
    room, n, zero = arb(ROOM), len(N), 0 * N
    moved = np.hstack([ball(point["stiffness"]), ball(point["damping"])]) * room
    work = power * np.vstack([zero @ moved, moved])
    allowed = np.block([[position * N, zero], [zero, velocity * N]]) * arb(LOOSE)
    used = moved.T @ (torque * W + energy * room * inverse(symmetric(point["inertia"]))) @ moved
    return sign(allowed - used + work + work.T) if n else -1


def robot(e, witness):
    """Decide whether all points lie in what the loop tolerates: in a ball, or by an affine Lyapunov function."""
    if witness:
        loop = (e["ball"] or {}).get("loop") or e["coupled_loop"]
        opened(loop, e["period"], "B_mismatch" if e["ball"] else "B")
        points = [point for point in e["points"].values() if point]
        return max(at_rest(loop, point, e["nominal_inertia"], e["period"], witness) for point in points)
    N, b, T, cover, rates = symmetric(e["nominal_inertia"]), e["ball"], e["period"], e["affine"], []
    W, points, own = inverse(N), [point for point in e["points"].values() if point], arb(0)
    if b is None or not e["robust_term_is_bounded"]:
        return -1, "no ball, or an unbounded slope"
    centre, radius, eta = (arb(b[name]) for name in ("centre", "radius", "position_weight"))
    lead, needed = b["loop"]["lead_periods"][0][0] * arb(T), radius
    if cover:
        of = cover["proof"]["ratios"]
        low, high, rate, own = (arb(of[name]) for name in ("min_ratio", "max_ratio", "rate", "relative_rate"))
        points, rates, inside = points + cover["force_points"], cover["rate_points"], of["intersample"]
        bounds = list(zip(of["powers"], of["lead_times"], of["stiffness"], strict=True))
        bounds = bounds if bounds or of["form"] else [(0, 0, 1e-9)]
        found = [affine_proof(cover["proof"], T, e["slope"])]
    else:
        low, high, rate = centre - radius, centre + radius, arb(0)
        bounds, inside = [] if eta > 0 else [(0, lead, 1e-9)], len(b["loop"]["B_mismatch"][0]) == 2
        if b["max_change"] is not None:
            rate, rates = arb(b["max_change"]) / T, [e["max_rate_point"]]
            bounds = bounds or [(0, lead, b["stiffness"])]
        found = [tolerates(b, T, e["slope"]), decays(b, e)]
        needed = radius if b["growth"] == 1 else arb(b["decay_radius"]) * LOOSE
        low, high = centre - needed, centre + needed
    found.append(1 if inside and low <= e["min_ratio"] <= e["max_ratio"] <= high else -1)
    for point in points:
        friction = np.array(point["damping"] if point["friction"] is None else point["friction"])
        damping = np.array(point["damping"]) * (point["velocity"] is not None)
        smooth, rough = (point | {"damping": damping + share * friction} for share in (0, 1))
        M = symmetric(point["inertia"])
        size = {0: M @ W @ M, 0.5: M, 1: N}
        found += [sign(M), sign(N - low * ROOM * M), sign(high / ROOM * M - N)]
        for one, (p, theta, x) in itertools.product((smooth, rough), bounds):
            found.append(sign((LOOSE * x / ROOM) ** 2 * size[p] - force(one, W, arb(theta))))
        found += [within_form(cover["proof"]["ratios"]["form"], one, N, W) for one in (smooth, rough) if cover]
        if not cover and eta > 0:
            of_ball = centre, needed, eta, lead, arb(b["stiffness"])
            found += [contained(one, N, W, of_ball, T) for one in (smooth, rough)]
    for point in rates:
        for change in changes(point):
            found.append(sign(LOOSE * rate / ROOM * N - change))
            found += [sign(LOOSE * own / ROOM * symmetric(point["inertia"]) - change)] if cover else []
    text = f"all points have {float(low):.6g} ≤ E ≤ {float(high):.6g} and what the loop tolerates"
    return min(found), text + decaying(cover["proof"]["growth"] if cover else b["growth"], T)


def lags(of):
    """Return φ of each bound on the forces, zero for a law without a stiffness of its own."""
    return of["lag_weights"] or [0] * len(of["powers"])


def affine_proof(proof, T, slope):
    """Decide whether V = Σ xᵀ(P0⊗I + (P1 + Q1)⊗Ē⁻¹)x decays for all E(t), stiffnesses and slopes that a proof names.

    Ē is the mean of E over a period. The loop of few states z differs from that of all states x by γe in its outputs;
    the storage shows Σ|e|² ≤ Σ|u|². The inputs u are mean and moment of the acceleration, less ρ0 v, and ρ0 w.
    """
    reduced, of, weights = proof["loop"], proof["ratios"], proof["multipliers"]
    loop, scales = reduced["full"]["loop"], ball(reduced["full"]["scales"])
    (A, B, C), mismatch = opened(loop, T, "B_mismatch"), ball(loop["B_mismatch"])
    robust, direct, Ar, Br = *(ball(loop[x]) for x in ("B_robust", "D_robust")), ball(reduced["A"]), ball(reduced["B"])
    centre, half, growth = arb(reduced["full"]["centre"]), arb(loop["half_slope"][0][0]), arb(proof["growth"])
    P0, P1, Q1, S, R, S0 = (symmetric(proof["matrices"][name]) for name in ("P0", "P1", "Q1", "S", "R", "S0"))
    following = (LOOSE * arb(of["nominal_rate"]) * T).exp() - 1  # ±ΔM̂ ⪯ following M̂ in a period, for M̂(q)
    low, high, n, k, count = arb(of["min_ratio"]), arb(of["max_ratio"]), len(mismatch.T), len(Ar), len(scales)
    turn, change = (LOOSE * arb(of[name]) * T for name in ("rate", "relative_rate"))  # of E⁻¹ in a period
    turned, inside = 1 / (1 - turn * high) if of["intersample"] else arb(1), of["intersample"]  # ‖E(t) Ē⁻¹‖
    swing = change / (1 - (-change).exp()) - 1 if inside and change > 0 else arb(0)  # ±(E(t) − Ē) ≤ swing Ē
    columns = *(of[x] for x in ("powers", "lead_times", "stiffness", "shares")), lags(of), weights["forces"]
    bounds = [[arb(x) for x in row] for row in zip(*columns, strict=True)]
    numbers = [
        turn,
        change,
        following,
        growth - 1,
        half - arb(slope) / 2,
        high - low,
        *(arb(weights[x]) for x in ("error", "change", "slope")),
    ]
    form = of["form"] and [arb(of["form"][x]) for x in FORM]
    ranges = [x > 0 for x in (low, centre, *scales)] + [x >= 0 for x in [*numbers, *itertools.chain(*bounds)]]
    ranges += [x >= 0 for x in form] + [inside and not bounds and of["form"]["split"] > 0] if form else []
    fits = (
        0 < turned < 3
        and of["period"] == T
        and (n == 2 or not (inside or bounds or form))
        and all(b[0] in (0, 0.5, 1) for b in bounds)
    )
    if not all(ranges) or not fits or not (3 if bounds or form else 2 if half > 0 else 1) <= count <= 4:
        return -1
    q = np.eye(2, len(A), dtype=int)
    v = C - half * direct @ q[:1]
    lag = q[:1] - np.eye(len(A), dtype=int)[-1:]
    A, X = A + centre * B @ v - half * robust @ q[:1], np.vstack([v, q, lag])[:count] * scales[:, None]
    B = np.hstack([mismatch, robust / centre + B @ direct])[:, : n + (half > 0)]
    L, Cr, zero = ball(reduced["projection"]), ball(reduced["C"]), np.zeros((len(A), k), dtype=int)
    step = np.vstack([np.hstack([A, zero, B]), np.hstack([Ar @ L - L @ A, Ar, Br - L @ B])])
    step = step * growth * (1 + following).sqrt()
    error = np.hstack([X - Cr @ L, -Cr, 0 * X[:, : len(B.T)]]) / arb(reduced["error_gain"])
    storage, stored = symmetric(reduced["storage"]), np.eye(len(step.T), dtype=int) * arb(1)
    stored[: len(step), : len(step)] = storage
    found = [sign(storage), sign(stored - error.T @ error - step.T @ storage @ step)]
    found += [sign(form) for end in (low, high) for form in (end * P0 + P1 + Q1, S + P1, S - P1, R + Q1, R - Q1)]
    found += [sign(form) for form in (S0 + P0, S0 - P0)] if following > 0 else []
    sizes = np.cumsum([k, count, 2 * bool(bounds or form), inside, half > 0])
    z, e, forces, c, w = np.split(np.eye(sizes[-1], dtype=int), sizes[:-1])

    kept = form and form_in_period(form, arb(of["form"]["split"]), T, turn * turned / 2, change, swing, high)
    if kept and not all(kept[3] + kept[4] * end - kept[5] * end**2 > 0 for end in (low, high)):
        return -1

    def decrease(x):
        """Return V now less V after a period, less what is known to be positive, all times E = x."""
        y = (Cr @ z + arb(reduced["error_gain"]) * e) / scales[:, None]
        v, position = y[:1] + direct * w.sum(axis=0), y[1:]
        mean = x * (v + forces[:1].sum(axis=0))
        moment = (c.sum(axis=0) + x * forces[1:].sum(axis=0))[None]
        u = np.vstack([np.vstack([mean - centre * v, moment])[:n], centre * w])
        later = Ar @ z + Br @ u
        F = z.T @ (x * P0 + P1 + Q1) @ z
        after = x * (P0 + turn * turned**2 * S + following * S0) + P1 + Q1 + (change.exp() - 1) * R
        F = F - growth**2 * later.T @ after @ later - x * arb(weights["error"]) * (u.T @ u - e.T @ e)
        F = F - arb(weights["change"]) * ((x * swing) ** 2 * v.T @ v * inside - c.T @ c)
        if half > 0:
            F = F - x * arb(weights["slope"]) * (half**2 * position[:1].T @ position[:1] - w.T @ w)
        for power, lead, bound, share, phi, weight in bounds:
            reach = (1 + phi**2) * (2 * T / arb.pi()) ** 2 + lead**2
            reach = T / arb.pi() * reach.sqrt()  # of the changes of E, by Wirtinger
            remaining = 1 - bound * reach * high**power
            size = (bound / remaining) ** 2 * {0: 1, 0.5: 1 + swing, 1: turned**2}[float(power)]
            if not remaining > 0:
                raise ZeroDivisionError
            track, ratio = np.vstack([position[:2], mean * arb(T) ** 2]), (lead / T) ** 2
            squares = ball(MEAN_SQUARES[0]) / 120 + ratio * ball(MEAN_SQUARES[1]) / 6
            late = np.vstack([position[2:] if count > 3 else 0 * v, track[1:]])  # since the sample of the torque
            moved = track.T @ squares @ track + phi**2 * late.T @ ball(MEAN_SQUARES[0]) @ late / 120
            known = size * (1 + share) * moved
            known = known + size * (1 + 1 / share) * (reach * swing) ** 2 * high * x * v.T @ v
            F = F - x * weight * (known - x ** int(2 - 2 * float(power)) * forces.T @ forces)
        if kept:
            of_position, of_velocity, power, *factors, uneven = kept
            track, half_time = np.vstack([position[:2], mean * arb(T) ** 2]), arb(T) / arb(12).sqrt()
            squares = ball(MEAN_SQUARES[0]) / 120 * of_position + ball(MEAN_SQUARES[1]) / 6 * of_velocity / arb(T) ** 2
            work = (position[1:2] / arb(T) + mean * arb(T) / 2 + half_time * c.sum(axis=0)).T @ forces[:1]
            work = power * (work - half_time * x * v.T @ forces[1:])
            size = factors[0] + factors[1] * x - factors[2] * x**2
            F = F - x * (track.T @ squares @ track + uneven * x * v.T @ v - work - work.T - size * forces.T @ forces)
        return F

    a, b, c_, d = (decrease(low + (high - low) * i / 3) for i in range(4))  # a cubic polynomial
    found.append(positive([a, (18 * b - 5 * a - 9 * c_ + 2 * d) / 6, (2 * a - 9 * b + 18 * c_ - 5 * d) / 6, d], sign))
    return min(found)


def form_in_period(form, split, T, moved, change, swing, high):
    """Return b, c, α2, a0, a1, a2 and e: (a0 + a1 λ − a2 λ²)|k'|² + 2α2 ms(ẋ·k') ≤ b ms(x) + c ms(ẋ) + e λ|v|².

    Here k' = Ē⁻¹E(t)k, and x and ẋ are those at the mean acceleration. A share of 1/64 of x and ẋ, and 1/32 of k, is
    left to what they differ by; |Ē⁻¹ − E(t)⁻¹| ≤ moved.
    """
    torque, energy, power, position, velocity = form
    reach, velocity = arb(T) / arb.pi(), velocity + power * moved * split
    within = 2 * 65 * reach**2 * (velocity + position * (2 * reach) ** 2)
    taken = torque * 31 * moved**2 + power * moved / split + within
    kept = energy * (-change).exp() - power * swing * reach, taken, within * swing**2 * high + power * swing * reach
    return position * 65 / 64, velocity * 65 / 64, power, torque * 31 / 32, *kept


def affine(e, witness):
    if witness or e["proof"] is None:
        return -1, "no Lyapunov function"
    of, T = e["proof"]["ratios"], e["proof"]["ratios"]["period"]
    fits = of["min_ratio"] <= e["min_ratio"] <= e["max_ratio"] <= of["max_ratio"] and e["rate"] <= of["rate"]
    fits = fits and arb(of["relative_rate"]) * LOOSE > arb(e["rate"]) * e["max_ratio"]
    text = f"decays by exp(−{math.log(e['proof']['growth']) / T:.4g} t) for all E(t) with {e['min_ratio']:.6g} ≤ E ≤ "
    text += f"{e['max_ratio']:.6g} and E⁻¹ changing by at most {e['rate']:.6g} 1/s"
    text += "" if of["intersample"] else ", constant within each period"
    return affine_proof(e["proof"], T, e["slope"]) if fits else -1, text
