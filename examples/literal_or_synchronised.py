"""Compare literal and synchronised time-delay estimation.

A two-link arm tracks a sine with three inertia gains.
Synchronised estimation averages the torque with the estimator's window and is stable with all three.
Literal estimation diverges with the largest.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import tarc

warnings.simplefilter("ignore", tarc.DesignWarning)  # that some of these are unstable is the point

arm = tarc.plants.TwoLinkArm(viscous=0.5, coulomb=0.5)
reference = tarc.signals.Sinusoid(amplitude=0.5, frequency=[2.0, 3.0], phase=np.pi / 2, offset=[0.0, np.pi / 2])
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for share in (0.05, 0.2, 0.8):
    for synchronised in (False, True):
        law = tarc.laws.TDC(
            inertia=share * arm.inertia([0.0, np.pi / 2]),
            natural_frequency=10.0,
            period=1e-3,
            estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
            synchronised=synchronised,
        )
        run = tarc.simulate(arm, law, reference, duration=5.0, initial_torque="rest")
        error = f"{1e3 * run.metrics(start_time=1.0)['rms_error']:.3f} mrad" if run.status.completed else ""
        kind = "synchronised" if synchronised else "literal"
        print(f"M̂ = {share:4} M, {kind:12}: {run.status} {error}")
        norm = 1e3 * np.linalg.norm(run.data["position"] - run.data["reference"], axis=1)
        axes.semilogy(run.data["time"], norm, "-" if synchronised else "--", label=f"{kind}, M̂ = {share} M")
axes.set(xlabel="time [s]", ylabel="error ‖e‖ [mrad]", ylim=(0.01, 1e4))
axes.legend(fontsize="small", ncols=2)
figure.savefig("literal_or_synchronised.png", dpi=110)
