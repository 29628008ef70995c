"""Change a gain while the loop runs, within the range in which the law is certified.

The robot is simulated by its own equations in a second process. Any thread may change gains: a timer does it here.
"""

from threading import Timer

import matplotlib.pyplot as plt
import numpy as np

import tarc
from tarc.analysis import Workspace
from tarc.certificates import certify_gains
from tarc.core.errors import InvalidParameter
from tarc.runtime import GainChanges, PlantRobot, run_live

arm = tarc.plants.TwoLinkArm()
home = np.array([0.0, 1.2])
law = tarc.laws.TDC(
    inertia=0.1 * arm.inertia(home),
    natural_frequency=10.0,
    period=2e-3,
    estimator=tarc.estimators.Algebraic(window=0.020),
)
region = Workspace(low=home - 0.2, high=home + 0.2, speed=np.ones(2))
certified = certify_gains(law, arm, region, samples=100)
frequencies = certified.ranges()["natural_frequency"]
print(f"natural frequency [rad/s]: {frequencies}")

changes = GainChanges(certified)
try:
    changes.change(natural_frequency=1000.0)
except InvalidParameter as refusal:
    print(refusal)

sway = tarc.signals.Sinusoid(amplitude=0.1, frequency=3.0, phase=np.pi / 2, offset=home)
new = {"natural_frequency": frequencies.nearest(18.0)}
with PlantRobot(arm, law.period, position=home, in_step=True) as robot:
    timer = Timer(3.0, changes.change, kwargs=new)
    result = run_live(
        law,
        robot,
        sway,
        duration=6.5,
        overrun="shift",
        watchdog=5.0,
        changes=changes,
        allow_unlimited_torque=True,
        log="change_gains.nc",
        on_log=lambda _: timer.start(),
    )
    timer.join()
print(result)
print(f"natural frequency at the end: {changes.law.natural_frequency:g} rad/s")

data = result.load().data
changed = data["time"].values[data["gain_changes"].values > 0][:1]
figure, axes = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True, layout="constrained")
axes[0].plot(data["time"], 1e3 * (data["position"] - data["reference"]), label=["joint 1", "joint 2"])
axes[0].set(ylabel="error [mrad]")
axes[0].legend()
axes[1].plot(data["time"], data["torque"])
axes[1].set(xlabel="time [s]", ylabel="torque [N m]")
for axis in axes:
    for time in changed:
        axis.axvline(time, color="black", linestyle="--", linewidth=1)
figure.savefig("change_gains.png", dpi=110)
