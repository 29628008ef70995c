"""How fast may a law be, and how much may the inertia vary? By the ball, and by an affine Lyapunov function.

Run it: python examples/affine_certificate.py
"""

import numpy as np

import tarc
from tarc.analysis import Workspace
from tarc.certificates import certify_affine, certify_robot, strengthen_robot

arm = tarc.plants.TwoLinkArm()
robots = [arm, arm.with_parameters({"payload": 2.0})]
workspace = Workspace.from_joint_limits(arm, speed=2.0)  # rad/s
inertia = 0.1 * np.array([[13.4, 5.04], [5.04, 5.04]])
estimator = tarc.estimators.Algebraic(window=0.006, degree=2)

for natural_frequency in (20.0, 40.0):
    law = tarc.laws.TDC(
        inertia=inertia,
        natural_frequency=natural_frequency,
        period=1e-3,
        estimator=estimator,
        synchronised=True,
    )
    ball = certify_robot(law, robots, workspace, samples=100)
    best = strengthen_robot(ball, law, robots, workspace, samples=100)
    decay = best.evidence.decay_rate
    print(
        f"{natural_frequency:g} rad/s: ball {ball.verdict}, margin {ball.margin:.3f}; "
        f"{best.evidence.method} {best.verdict}, margin {best.margin:.3f}"
        + (f", errors decay as e^(−{decay:.2g} t)" if decay else "")
    )

# one joint, or any number of them: the ratio, and how fast it changes
certificate = certify_affine(law, (0.08, 1.8), rate=50.0)
print(certificate.explain())
