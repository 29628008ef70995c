"""Track a sine with TARC on a two-link arm.

The shortest program: a robot, a law, a reference, a run.
The law sees a 16-bit encoder and the reference, nothing else.
"""

import numpy as np

import tarc

arm = tarc.plants.TwoLinkArm()
law = tarc.laws.TARC(
    inertia=0.05 * np.array([[3.0, 1.0], [1.0, 1.0]]),
    natural_frequency=10.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
    rise_rate=2000.0,
    fall_rate=1000.0,
)
reference = tarc.signals.Sinusoid(amplitude=[0.6, 0.6], frequency=[2.0, 2.5])  # rad, rad/s
run = tarc.simulate(arm, law, reference, duration=10.0, sensor=tarc.signals.Encoder(bits=16))
print(run.metrics()["rms_error"], run.status)
run.plot().savefig("two_link.png", dpi=110)
