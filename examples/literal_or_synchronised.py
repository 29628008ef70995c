"""Average the torque with the window, and an inertia gain is stable that literal TDE cannot bear."""

import warnings

import numpy as np

import tarc

warnings.simplefilter("ignore", tarc.DesignWarning)  # that some of these are unstable is the point

arm = tarc.plants.TwoLinkArm(viscous=0.5, coulomb=0.5)
reference = tarc.signals.Sinusoid(amplitude=0.5, frequency=[2.0, 3.0], phase=np.pi / 2, offset=[0.0, np.pi / 2])
for share in (0.05, 0.2, 0.8):
    for synchronised in (False, True):
        law = tarc.laws.TDC(
            inertia=share * arm.inertia([0.0, np.pi / 2]),
            bandwidth=10.0,
            period=1e-3,
            estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
            synchronised=synchronised,
        )
        run = tarc.simulate(arm, law, reference, duration=5.0, torque="rest")
        error = f"{1e3 * run.metrics(start=1.0)['rms_error']:.3f} mrad" if run.status.completed else ""
        print(f"M̂ = {share:4} M, {'synchronised' if synchronised else 'literal':12}: {run.status} {error}")
