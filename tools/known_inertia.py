"""Certificates of laws with M̂(q): a ball in a norm that follows the posture, or a Lyapunov function in M̂ and M."""

import numpy as np
from flint import arb

from ball_arithmetic import LEAST, LOOSE, ROOM, ball, inverse, opened, sign, symmetric
from uncertain_inertia import affine_proof, at_rest, changes, contained, force, lags, tolerates


def relative_rate(point, inertia):
    """Return the largest |M^−½ (dM/dt) M^−½| of a point, and the sign of its proof."""
    M, moved = symmetric(inertia), list(changes(point))
    values = [np.linalg.eigvals(np.linalg.solve(np.array(inertia), np.array(change, dtype=float))) for change in moved]
    rate = arb(float(np.abs(values).max())) * LOOSE + arb(2) ** -200
    return rate, min(sign(rate * M - change) for change in moved)


def largest_stiffness(points, lead, T):
    """Return a little more than sup|[H, C/θ]|, with 5 % more of both, at the start and the end of a period."""
    largest = 0.0
    for known in points:
        M, D, G = (np.array(known["robot"][name]) for name in ("inertia", "damping", "stiffness"))
        W = np.linalg.inv(np.array(known["nominal"]))
        for damping in (D, D + T * (G + np.array(known["model_stiffness"]))):
            size = np.linalg.solve(M @ W @ M, G @ W @ G.T + damping @ W @ damping.T / lead**2)
            largest = max(largest, float(np.abs(np.linalg.eigvals(size)).max()))
    return arb(largest).sqrt() * ROOM * LOOSE + LEAST


def delayed(loop, periods):
    """Return A and C of a loop with the positions of the last periods as further states."""
    A, C, n = loop["A"], loop["C"], len(loop["A"])
    older = [[float(j == (0 if i == n else i - 1)) for j in range(n + periods)] for i in range(n, n + periods)]
    return [row + [0.0] * periods for row in A] + older, [C[0] + [0.0] * periods]


def known_inertia(e, witness):
    """Decide whether what M̂(q) is and changes lies in what the loop tolerates, with room."""
    T, loop, proof, rest = e["period"], e["loop"], e["affine"], e["rest_loop"]
    opened(loop, T, "B_mismatch")
    if witness:
        return at_rest(rest["loop"], rest["robot"], rest["nominal"], T, witness)
    if not e["robust_term_is_bounded"]:
        return -1, "an unbounded slope"
    slope, centre, radius = 2 * loop["half_slope"][0][0], arb(e["centre"]), arb(e["radius"])
    eta, lead = arb(e["position_weight"]), arb(loop["lead_periods"][0][0]) * T
    rate, is_rate = relative_rate(e["rate_point"], e["rate_point"]["nominal"])
    rate = rate if proof else rate * ROOM
    turned, later = (rate * T).exp(), (rate * T * (1 + e["computation_delay"])).exp()
    low, high, found = arb(e["min_ratio"]) / LOOSE, arb(e["max_ratio"]) * LOOSE, [is_rate]
    needed, wider = radius / turned - high * ROOM * (later - 1), arb(1)
    if proof:
        of, full = proof["ratios"], proof["loop"]["full"]["loop"]
        own, is_own = relative_rate(e["relative_rate_point"], e["relative_rate_point"]["inertia"])
        limits = {"relative_rate": own, "rate": own * later / low, "nominal_rate": rate, "max_ratio": high * later}
        fits = all(need * ROOM <= arb(of[name]) * LOOSE**4 for name, need in limits.items())
        fits = fits and low / later >= arb(of["min_ratio"]) * ROOM / LOOSE**4 and of["intersample"]
        past = e["computation_delay"] if of["lag_weights"] else 0
        fits = fits and (full["A"], full["C"]) == delayed(loop, past)
        fits = fits and (not past or len(proof["loop"]["full"]["scales"]) == 4)
        found += [is_own, affine_proof(proof, T, slope), 1 if fits else -1]
        bounds = list(zip(of["powers"], of["lead_times"], of["stiffness"], lags(of), strict=True)) or [(0, 0, 1e-9, 0)]
        wider = later * ROOM if of["powers"] else wider
    else:
        ball_of = {name: e[name] for name in ("loop", "centre", "radius", "position_weight", "scale")}
        ball_of |= {"stiffness": 0, "max_change": None, "multiplier": None}
        found += [1 if needed > 0 and len(loop["B_mismatch"][0]) == 2 else -1]
        found += [tolerates(ball_of, T, slope, (rate * T / 2).exp())]
        if e["decay_growth"] != 1:
            decaying = ball_of | {"radius": e["decay_radius"]}
            found += [1 if e["decay_growth"] > 1 and 0 < e["decay_radius"] <= e["radius"] else -1]
            found += [tolerates(decaying, T, slope, (rate * T / 2).exp() * arb(e["decay_growth"]))]
            needed = arb(e["decay_radius"]) * LOOSE / turned - high * ROOM * (later - 1)
        bounds = [] if eta > 0 else [(0, lead, 1e-9, None)]
    for known in e["points"]:
        point, N = known["robot"], symmetric(known["nominal"])
        M, W = symmetric(point["inertia"]), inverse(N)
        size = {0: M @ W @ M, 0.5: M, 1: N}
        found += [sign(M), sign(LOOSE * N - low * M), sign(LOOSE * high * M - N)]
        for p, theta, x, phi in bounds:
            needs = force(point, W, arb(theta))
            if phi is not None:  # the law's own stiffness
                needs = needs + force({"stiffness": 0 * M, "damping": known["model_stiffness"]}, W, arb(phi))
            found.append(sign((LOOSE * x / wider) ** 2 * size[p] - needs))
        if not proof and eta > 0:
            of_ball = centre, needed, eta, lead, largest_stiffness(e["points"], float(lead), T)
            found.append(contained(point, N, W, of_ball, T, ball(known["model_stiffness"])))
        elif not proof:
            found += [sign(N * ROOM - (centre - needed) * M * ROOM**2), sign((centre + needed) * M - N * ROOM)]
    return min(found), f"all points have {e['min_ratio']:.6g} ≤ E ≤ {e['max_ratio']:.6g} and what the loop tolerates"
