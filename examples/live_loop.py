"""Run a law on a robot in real time, and look at its timing.

MuJoCo simulates a UR5e in a second process that keeps its own clock. Put your own `tarc.runtime.Robot`, or
`udp_robot("udp://host:port")`, in its place.
"""

import matplotlib.pyplot as plt
import numpy as np

import tarc
from tarc.runtime import MujocoRobot, Push, SafetyLimits, StartUp, run_live

arm = tarc.plants.load_robot("ur5e", armature=0.1, viscous=1.0)
home = arm.home
law = tarc.laws.TDC(
    inertia=0.08 * arm.inertia(home),
    natural_frequency=20.0,
    period=2e-3,
    estimator=tarc.estimators.Algebraic(window=0.020),
    torque_limit=arm.torque_limits,
    max_missing=500,
)
reference = tarc.signals.Sinusoid(amplitude=0.1, frequency=3.0, phase=np.pi / 2, offset=home)
with MujocoRobot(arm, law.period, position=home, step_size=2 * np.pi / 2**17) as robot:
    result = run_live(
        law,
        robot,
        reference,
        duration=1.0,
        limits=SafetyLimits(error=0.5, max_step=0.2),
        start_up=StartUp(ramp_time=0.5, push=Push(inertia=arm.inertia(home))),
        watchdog=1.0,
        log="live_loop.nc",
        joint_names=arm.joint_names,
        label="UR5e",
    )
print(result)
for name, text in result.facts.items():
    print(f"{name}: {text}")
for name, response in zip(arm.joint_names, result.push, strict=False):
    print(f"{name}: inertia ratio {response.ratio:.3f}, {response.fault or 'as it should'}")

data = result.load().data
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
left.plot(data["time"], 1e3 * (data["position"] - data["reference"]), label=arm.joint_names)
left.set(xlabel="time [s]", ylabel="error [mrad]")
left.legend(fontsize="small")
counts, edges = result.histogram()
right.stairs(counts, 1e6 * edges, fill=True)
right.set(xscale="log", xlim=(1, 1e5), yscale="log", xlabel="start after the deadline [µs]", ylabel="periods")
figure.savefig("live_loop.png", dpi=110)
