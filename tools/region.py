"""Certificates of a region of attraction: a Lyapunov function of the nonlinear loop in a tube about a reference."""

import numpy as np
from flint import arb

from ball_arithmetic import LOOSE, ball, inverse, positive, sign, symmetric
from uncertain_inertia import MEAN_SQUARES


def terms(p):
    """Return what the weights multiply in V⁺ ≤ ϱ V + g: of the forces, and of f, n, r and δ."""
    of, bounds, T = p["ratios"], p["bounds"], arb(p["ratios"]["period"])
    high, turned, swing = arb(of["max_ratio"]), *uneven(of)
    drift = arb(bounds["held"]) / arb(3).sqrt() + arb(bounds["torque"])
    forces = []
    for lead, kappa, share in zip(of["lead_times"], of["stiffness"], of["shares"], strict=True):
        reach = T / arb.pi() * ((2 * T / arb.pi()) ** 2 + arb(lead) ** 2).sqrt()
        remaining = 1 - arb(kappa) * reach * high
        if not remaining > 0:
            raise ZeroDivisionError
        size, rest = (turned * kappa / remaining) ** 2, 1 + 1 / arb(share)
        within = size * rest * 2 * reach**2
        forces.append(
            (size * (1 + arb(share)), (arb(lead) / T) ** 2, within * swing**2 * high, within * (high * drift) ** 2)
        )
    return forces, [(turned * drift) ** 2, *(arb(bounds[x]) ** 2 for x in ("noise", "residual", "change"))]


def uneven(of):
    """Return ‖E(t) Ē⁻¹‖ of a period and the ε of ±(E(t) − Ē) ≤ ε Ē."""
    turn, change = (LOOSE * arb(of[name]) * of["period"] for name in ("rate", "relative_rate"))
    return 1 / (1 - turn * of["max_ratio"]), change / (1 - (-change).exp()) - 1 if change > 0 else arb(0)


def falls(p, low, high):
    """Decide whether V falls as claimed at all ratios x from low to high: a cubic polynomial in x."""
    loop, of, weights, T = p["loop"], p["ratios"], p["weights"], arb(p["ratios"]["period"])
    A, B, C, N, R, X, rows = (ball(loop[x]) for x in ("A", "B", "C", "noise", "residual", "change", "outputs"))
    d, s = arb(loop["noise_gain"][0][0]), arb(loop["residual_gain"][0][0])
    P0, P1, Q1, S, Z, S0 = (symmetric(p["matrices"][name]) for name in ("P0", "P1", "Q1", "S", "R", "S0"))
    followed = (LOOSE * arb(of["nominal_rate"]) * T).exp() - 1
    turn, change = (LOOSE * arb(of[name]) * T for name in ("rate", "relative_rate"))
    turned, swing = uneven(of)
    half = arb(loop["half_slope"])
    sizes = np.cumsum([len(A), 2, 1, 2, 1, 1, 1, half > 0])
    z, k, c, f, n, r, delta, w = np.split(np.eye(sizes[-1], dtype=int), sizes[:-1])
    added = r + w.sum(axis=0)
    v = C @ z + d * n + s * added
    forces, _ = terms(p)

    def decrease(x):
        mean, moment = x * (v + k[:1] + f[:1]), c + x * (k[1:] + f[1:])
        later = A @ z + B[:, :1] @ mean + B[:, 1:] @ moment + N @ n + R @ added + X @ delta
        after = x * (P0 + turn * turned**2 * S + followed * S0) + P1 + Q1 + (change.exp() - 1) * Z
        F = arb(p["decay"]) * z.T @ (x * P0 + P1 + Q1) @ z - later.T @ after @ later
        track = np.vstack([rows @ z, mean * T**2])
        for weight, (size, lead, within, _) in zip(weights["forces"], forces, strict=True):
            squares = ball(MEAN_SQUARES[0]) / 120 + lead * ball(MEAN_SQUARES[1]) / 6
            F = F - x * arb(weight) * (size * track.T @ squares @ track + within * x * v.T @ v - k.T @ k)
        F = F - arb(weights["swing"]) * ((x * swing) ** 2 * v.T @ v - c.T @ c)
        if half > 0:
            F = F - x * arb(weights["slope"]) * (half**2 * (rows[:1] @ z + n).T @ (rows[:1] @ z + n) - w.T @ w)
        for name, part in (("drift", f), ("noise", n), ("residual", r), ("change", delta)):
            F = F + x * arb(weights[name]) * part.T @ part
        return F

    a, b, c_, d_ = (decrease(low + (high - low) * i / 3) for i in range(4))
    forms = [end * P0 + P1 + Q1 for end in (low, high)] + [S + P1, S - P1, Z + Q1, Z - Q1]
    forms += [S0 + P0, S0 - P0] if of["nominal_rate"] > 0 else []
    bernstein = [a, (18 * b - 5 * a - 9 * c_ + 2 * d_) / 6, (2 * a - 9 * b + 18 * c_ - 5 * d_) / 6, d_]
    return min(*(sign(form) for form in forms), positive(bernstein, sign))


def region(e, witness):
    """Decide whether errors up to R0 never exceed R and end below R∞, all in coordinates M̂^½ q."""
    p = e["proof"]
    if witness or p is None:
        return -1, "no Lyapunov function"
    of, bounds, weights, loop = p["ratios"], p["bounds"], p["weights"], p["loop"]
    low, high, T, level, decay = (
        arb(x) for x in (of["min_ratio"], of["max_ratio"], of["period"], p["level"], p["decay"])
    )
    turned, swing = uneven(of)
    numbers = [of[name] for name in ("rate", "relative_rate", "nominal_rate")] + [*bounds.values(), *of["stiffness"]]
    numbers += [*of["lead_times"], *of["shares"]]
    numbers += [*weights["forces"], *(weights[x] for x in weights if x != "forces")]
    numbers += [loop["half_slope"], p["rest_stiffness"], p["start_torque"], p["start_velocity"]]
    fits = 0 < low <= high and 0 < turned < 3 and 0 < decay < 1 and level > 0 and loop["period"] == T
    fits = fits and all(x >= 0 for x in numbers) and set(of["powers"]) <= {1.0} and of["intersample"]
    if not fits:
        return -1, "numbers out of range"
    forces, squares = terms(p)
    g = sum((arb(w) * x[3] for w, x in zip(weights["forces"], forces, strict=True)), arb(0))
    g += sum(
        (arb(weights[x]) * y for x, y in zip(("drift", "noise", "residual", "change"), squares, strict=True)), arb(0)
    )
    P0, P1, Q1 = (symmetric(p["matrices"][name]) for name in ("P0", "P1", "Q1"))
    ends = [P0 + (P1 + Q1) / end for end in (low, high)]
    inverses = [inverse(P) for P in ends]

    def norm(y):
        return max((y @ P @ y).sqrt() for P in ends)

    def gain(row):
        return max((row @ W @ row).sqrt() for W in inverses)

    (position, velocity), tube, N = ball(loop["outputs"]), p["tube"], symmetric(e["nominal_inertia"])

    def largest(value):
        v = value.sqrt() * gain(ball(loop["C"])[0]) + abs(arb(loop["noise_gain"][0][0])) * bounds["noise"]
        robust = arb(loop["half_slope"]) * (arb(tube["error"]) + bounds["noise"])
        v += abs(arb(loop["residual_gain"][0][0])) * (bounds["residual"] + robust)
        reach = [
            x * (arb(tube["error"]) ** 2 + (arb(y) * tube["error_rate"]) ** 2).sqrt()
            for x, y in zip(of["stiffness"], of["lead_times"], strict=True)
        ]
        force = arb(bounds["held"]) + bounds["torque"] + (min(reach, key=float) if reach else 0)
        sag, slope = high * (v + force) * T**2 / 8, high * (swing * v + 2 * force) * T / 2
        end = (value * (LOOSE * arb(of["nominal_rate"]) * T).exp()).sqrt()
        return end * gain(position) + sag, end * gain(velocity) / T + slope

    unit, rate, window, torque = ball(loop["starts"]).T
    error, error_rate = largest(level)
    final = g / (1 - decay)
    start = (norm(unit + window) + p["rest_stiffness"] * norm(torque)) * e["start_error"]
    start += norm(torque) * p["start_torque"] + norm(rate) * p["start_velocity"] * T + norm(window) * bounds["noise"]
    units = [LOOSE * arb(x) for x in e["error_units"]]
    holds = [error <= tube["error"] * LOOSE, error_rate <= tube["error_rate"] * LOOSE, final < level]
    holds += [start <= level.sqrt() * LOOSE, largest(final)[0] <= e["final_error"] * LOOSE, arb(e["start_error"]) > 0]
    holds += [x**2 >= y for x, y in zip(units, np.diag(inverse(N)), strict=True)]
    holds += [x * tube["error"] <= LOOSE**2 * arb(y) for x, y in zip(units, e["max_error"], strict=True)]
    found = min(falls(p, low, high), sign(N), 1 if all(holds) else -1)
    text = f"|M̂^½ e| up to {e['start_error']:.4g} at the start never exceeds {tube['error']:.4g}"
    return found, f"{text} and ends below {e['final_error']:.4g}"
