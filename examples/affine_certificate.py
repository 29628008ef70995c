"""How much may the inertia vary, and how fast.

Two certificates for a ratio that changes: the ball with a multiplier, and a Lyapunov function affine in the inertia.
The latter is proven in ball arithmetic, and allows almost as much as a constant ratio up to fast changes.
Here the inertia changes from period to period; within a period too by default.
"""

import matplotlib.pyplot as plt

import tarc
from tarc.certificates import certify_affine, certify_varying_ratio

law = tarc.laws.TDC(
    inertia=0.1,
    natural_frequency=10.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.005, degree=2),
    synchronised=True,
)
low, high = tarc.analysis.stable_interval(law)
print(f"constant: {high / low:.0f}")


def widest_spread(rate: float, top: float) -> float:
    """Return the largest certified quotient of the ends, by bisection on ranges below one upper end."""
    certified, refused = 2.0, top / low
    while refused > 1.05 * certified:
        middle = (certified * refused) ** 0.5
        if certify_affine(law, (top / middle, top), rate, intersample=False).certified:
            certified = middle
        else:
            refused = middle
    return certified


rates = [1.0, 10.0, 100.0, 1000.0]
affine = [max(widest_spread(rate, share * high) for share in (0.85, 0.96)) for rate in rates]
ball = [certify_varying_ratio(law, rate=rate, intersample=False).evidence.ratio_spread for rate in rates]
for rate, first, second in zip(rates, ball, affine, strict=True):
    print(f"{rate:6g} 1/s: ball {first:4.0f}, affine function {second:4.0f}")

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.axhline(high / low, color="0.5", ls="--", label="constant ratio")
axes.loglog(rates, affine, "o-", label="affine Lyapunov function")
axes.loglog(rates, ball, "s-", label="ball with a multiplier")
axes.set_xlabel("rate of the inertia in units of M̂ [1/s]")
axes.set_ylabel("largest over smallest ratio, certified")
axes.set_ylim(10, 300)
axes.grid(alpha=0.3)
axes.legend()
figure.savefig("affine_certificate.png", dpi=110)
