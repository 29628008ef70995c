"""Decide certificates of stability from their JSON files alone: python tools/check_certificate.py FILE...

It shares no code with the package that writes them, and needs numpy and python-flint only. Every sign is decided in
ball arithmetic, on the stored numbers as exact fractions, so that "holds" is a proof. Where the matrices come from is
not proven, but printed as assumed. The exit status is 1 unless all certificates hold.
"""

import itertools
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from flint import arb, arb_poly, ctx, fmpq, fmpq_poly

from ball_arithmetic import ball, inverse, on_circle, opened, sign, stable, symmetric
from known_inertia import known_inertia
from region import region
from uncertain_inertia import affine, robot, varying_ratio


def one_parameter(e, witness):
    """Decide A + κBC for all constant κ of a range, or for all κ(t): by the small-gain theorem, from its middle."""
    constant = "min_ratio" in e
    low, high = (e["min_ratio"], e["max_ratio"]) if constant else (0, e["max_slope"])
    loops = [opened(loop, e["period"]) if constant else [ball(loop[name]) for name in "ABC"] for loop in e["loops"]]
    growth = 1 if witness else (arb(e["decay_rate"]) * e["period"]).exp()
    loops = [(A * growth, B * growth if constant else -B * growth, C) for A, B, C in loops]
    name = "constant ratio ρ" if constant else "slope κ(t) of the robust term"
    if witness:
        at, rate = witness["ratio" if constant else "slope"], witness["growth_rate"] * e["period"] * 0.999
        found = max(-stable((A + arb(at) * B @ C) / arb(rate).exp()) for A, B, C in loops)
        return found if low <= at <= high and rate > 0 else -1, f"a mode grows at the {name} of {at:.6g}"
    pieces = [(*loop, low, high) for loop in loops if low <= high and growth >= 1 and e.get("gain_is_bounded", True)]
    found = 1 if pieces else -1
    for _ in range(500):
        if found != 1 or not pieces:
            break
        A, B, C, first, last = pieces.pop()
        middle = (first + last) / 2
        half = max(arb(last) - middle, middle - arb(first))
        X, D = A + arb(middle) * B @ C, ball(np.zeros((len(C), len(B.T))))
        found = stable(X)
        if found == 1 and first < last:
            found = on_circle(X, B, C, D, lambda _, G, r=half: np.eye(len(G.T), dtype=int) - r**2 * np.conj(G.T) @ G)
            if constant and found == -1:  # the ball is too large, not the range
                found = 1
                pieces += [(A, B, C, first, middle), (A, B, C, middle, last)]
    text = f"errors decay by exp(−{e['decay_rate']:.4g} t) for every {name} from {low:.6g} to {high:.6g}"
    return 0 if pieces and found == 1 else found, text


def lemma1(e, witness):
    """‖M⁻¹M̂ − I‖ < c is c²M² − (M̂ − M)² > 0, with c = 1; for a refutation the norm of the witness is reached."""
    M, N = symmetric(e["inertia"]), symmetric(e["nominal_inertia"])
    bound = max(1.0, witness["norm"] * (1 - 1e-6)) if witness else 1.0
    found = sign(arb(bound) ** 2 * M @ M - (N - M) @ (N - M))
    if witness:
        found = min(-found, sign(M)) if witness["posture"] == e["posture"] else -1
        return found, f"‖M⁻¹M̂ − I‖ ≥ {bound:.6g} at q = {e['posture']}"
    return min(found, sign(M)), f"‖M⁻¹M̂ − I‖ < 1 at q = {e['posture']}"


def c2(e, witness):
    P, A = symmetric(e["P"]), ball(e["A"])
    n = len(P) // 2
    P2, P3 = P[n:, :n], P[n:, n:]
    if witness:
        x = ball(witness["vector"])
        return sign(np.array([[-x @ P3 @ P2.T @ x]])), "P3 P2ᵀ is negative at the vector of the witness"
    pairs = [(ball(x["error"]), ball(x["error_rate"])) for x in (e["shrinking"], e["growing"]) if x]
    found = [sign(P), sign(-(A.T @ P + P @ A)), sign(P3 @ P2.T)]
    found += [sign(np.array([[-rate @ P3 @ P2 @ error]])) for error, rate in pairs]
    return min(found), "P > 0, AᵀP + PA < 0 and P3 P2ᵀ > 0, and Δsᵀs < 0 at the counterexamples"


def theorem(e, witness):
    """Ψ of Theorem 1, or the reduced Θ of Theorem 2, in e, e_h and ∫Ω_1 e_h."""
    second = "part" in e
    h, beta, xi = (arb(e["condition"][name]) for name in ("delay", "beta", "xi"))
    found, values = [1 if h > 0 and beta > 0 and xi > 1 and e["condition"].get("window", 1) > 0 else -1], []
    for part in [e["part"]] if second else e["parts"]:
        K1, K2 = ball(part["K1"]), ball(part["K2"])
        P, D, *L = (symmetric(part[name]) for name in ("P", "D", "L")[: 2 + second])
        zero, one = 0 * K1, np.eye(len(K1), dtype=int)
        A1, B1 = np.block([[zero, one], [zero, zero]]), np.block([[zero, zero], [-K1, -K2]])
        bar, breve = (np.block([[zero, zero], [X, Y]]) for X, Y in ((K2, zero), (zero, K2)))
        factors = (
            [A1, B1] + [np.eye(len(P), dtype=int)] * (second or e["condition"]["disturbance_term"]) + [bar] * second
        )
        inner = sum(X @ inverse(D) @ X.T for X in factors)
        delayed, A = h**2 / beta * D, A1 + B1
        first = -(A.T @ P + P @ A) - beta * P @ B1 @ inner @ B1.T @ P - (1 + xi) * delayed
        forms, length = [first, (xi - 1) * delayed], 1
        if second:
            energy = sum((2 * k + 1) * (k * (k + 1)) ** 2 for k in range(1, e["condition"]["degree"] + 1))
            F = (delayed + L[0]) * energy / arb(e["condition"]["window"]) ** 2
            rows = [first, P @ breve, P @ bar], [(P @ breve).T, forms[1] - F, 0 * P], [(P @ bar).T, 0 * P, L[0]]
            forms, length = [np.block([list(row) for row in rows])], 3
        found += [sign(weight) for weight in (P, D, *L)] + ([] if witness else [sign(form) for form in forms])
        if witness and len(witness["e"]) == len(P):
            x = np.concatenate([factor * ball(witness["e"]) for factor in (1, -1, 0)[:length]])
            values.append(sign(np.array([[-x @ forms[0] @ x]])))
    if witness:
        return min(
            *found, max(values)
        ), "the weights are positive and the form is negative at the vector of the witness"
    return min(found) if len(found) > 1 else -1, "the form and its weights are positive definite"


def lag_area(degree):
    """Return ∫|g| of the window [−1, 0]: Ω_1 = Σ (2k+1) k (k+1) P_k(2ψ + 1), w = −∫Ω_1, g = ∫w from −1."""
    terms = np.polynomial.legendre.leg2poly([(2 * k + 1) * k * (k + 1) for k in range(degree + 1)])
    g = fmpq_poly([fmpq(*float(term).as_integer_ratio()) for term in terms]).integral()
    g = ((g(-1) - g) / 2).integral()
    g = (g - g(-1)) / 2
    roots: Any = g.numer().complex_roots()
    turns = [root.real for root, _ in roots if abs(root.real) < 1]
    heights = [arb_poly(g.integral())(x) for x in (arb(-1), *sorted(turns, key=float), arb(1))]
    return sum(abs(after - before) for before, after in itertools.pairwise(heights)) / 2


def nominal(e, witness):
    """V̇ + 2aV ≤ γ²|σ'|², less |e1|² for a = 0, holds along the nominal loop with its delay and its window."""
    h, window, a = (arb(e["loop"][name]) for name in ("delay", "window", "decay_rate"))
    if witness or e["gamma"] is None or not (h > 0 and window > 0 and a >= 0) or not e["parts"]:
        return -1, "no functional"
    gamma, G = arb(e["gamma"]), h + window * lag_area(e["loop"]["degree"])
    gain = e["peak_gain"] * (2 * e["loop"]["decay_rate"]) ** 0.5 if a > 0 else e["mean_square_gain"]
    found = [1 if gamma > 0 and abs(gain - e["gamma"]) <= 1e-12 * e["gamma"] else -1]
    for part in e["parts"]:
        K1, K2, P, R1, R2 = *(ball(part[x]) for x in ("K1", "K2")), *(symmetric(part[x]) for x in ("P", "R1", "R2"))
        n = len(K1)
        (e1, e2, z1, z2, sigma) = np.eye(5 * n, dtype=int).reshape(5, n, 5 * n)
        faster = -K1 @ (e1 - z1) - K2 @ (e2 - z2) + sigma
        x, moved = np.vstack([e1, e2]), np.vstack([e2, faster])
        F = x.T @ P @ moved + moved.T @ P @ x + 2 * a * x.T @ P @ x + h * e2.T @ R1 @ e2 + G * faster.T @ R2 @ faster
        F = F - (-2 * a * h).exp() / h * z1.T @ R1 @ z1 - (-2 * a * (h + window)).exp() / G * z2.T @ R2 @ z2
        F, least = F - gamma**2 * sigma.T @ sigma, e1.T @ e1
        found += [sign(X) for X in (P, R1, R2)]
        found += [sign(-F), sign(P - least[: 2 * n, : 2 * n])] if a > 0 else [sign(-F - least)]
    peak = arb(gain) / (2 * a).sqrt() if a > 0 else arb(gain)
    return min(found), f"|e1| is at most {float(peak):.6g} times |σ'|"


CHECKS = dict(constant_ratio=one_parameter, sector=one_parameter, varying_ratio=varying_ratio, affine=affine)
CHECKS |= dict(robot=robot, known_inertia=known_inertia, lemma1=lemma1, c2=c2, theorem1=theorem, theorem2=theorem)
CHECKS |= dict(nominal=nominal, region=region)


def decide(content):
    """Return 1, −1 or 0 for a certificate that holds, does not or is not decided, and what is proven."""
    verdict, check, text = content["verdict"], CHECKS.get(content["kind"]), ""
    if check is None or verdict not in ("certified", "refuted", "inconclusive"):
        return 0, "unknown kind or verdict"
    if verdict == "inconclusive":
        return 1, "nothing, and nothing is claimed"
    if verdict == "refuted" and not content["witness"]:
        return -1, "no witness"
    for bits in (256, 1024, 3072):
        try:
            with ctx.workprec(bits):
                found, text = check(content["evidence"], content["witness"] if verdict == "refuted" else None)
        except (ArithmeticError, AttributeError, IndexError, KeyError, TypeError, ValueError) as problem:
            found, text = 0, f"{type(problem).__name__}: {problem}"
        if found:
            return found, text
    return 0, text


def report(name, content):
    """Print what a certificate says, whether it holds, what is proven and what is assumed; return whether it holds."""
    start, slow = time.monotonic(), threading.Timer(2.0, print, ["."], {"file": sys.stderr, "end": ""})
    slow.start()
    found, text = decide(content)
    slow.cancel()
    words = {1: "holds", -1: "does not hold", 0: "not decided"}[found]
    took = f" ({seconds:.1f} s)" if (seconds := time.monotonic() - start) > 2 else ""
    print(f"{name}: {content.get('kind')} {content.get('verdict')}: {words}{took}", f"  tested: {text}", sep="\n")
    if content.get("verdict") != "inconclusive":
        print("  assumed: the matrices are those of the law and the robot")
        print(*(f"  assumed: {line}" for line in content["assumptions"]), sep="\n")
    return found == 1


def main(paths):
    """Report all certificates in files, each with one certificate or several by name; return the exit status."""
    results = []
    for path in paths:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        named = {content["kind"]: content} if "evidence" in content else content
        results += [report(f"{path} {name}", certificate) for name, certificate in named.items()]
    return 0 if results and all(results) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
