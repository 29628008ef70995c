"""Watch an arm move in three dimensions.

An arm of three links picks up a load, once with the larger and once with the smaller gains.
`animation.html` plays both runs side by side in any browser, without a server.
The ghosts are the references, and the slider is the time.
"""

import numpy as np

import tarc

arm = tarc.plants.NLinkArm(masses=(2.0, 1.5, 1.0), viscous=(0.5, 0.5, 0.5))
reference = tarc.signals.Sinusoid(amplitude=[0.8, 0.6, 0.6], frequency=[2.0, 3.0, 4.0], phase=np.pi / 2)
payload = tarc.signals.Payload(mass=2.0, start_time=1.5)
runs = []
for natural_frequency in (4.0, 15.0):
    law = tarc.laws.TDC(
        inertia=0.5 * arm.mean_inertia(reference.sample(np.linspace(0.0, 6.0, 50))[0]),
        natural_frequency=natural_frequency,
        period=1e-3,
        synchronised=True,
        estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
    )
    run = tarc.simulate(arm, law, reference, duration=6.0, disturbance=payload, initial_torque="rest")
    runs.append(run)
    print(f"{natural_frequency:2g} rad/s: {run.status}, RMS error {1e3 * run.metrics()['rms_error']:.2f} mrad")

slow, quick = runs
slow.animate("animation.html", others={"TDC, 15 rad/s": quick})
quick.plot().savefig("animation.png", dpi=110)
