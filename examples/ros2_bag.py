"""Save a run as a ROS 2 bag, and let a stiffer law follow the reference in it.

The bag has joint states, the reference as one `JointTrajectory`, and the signals of the law. Tools of ROS play and plot
it. Here the reference of one run becomes that of the next. `tarc run ur5e --reference run.mcap` does the same.
"""

from dataclasses import replace

import tarc

arm = tarc.plants.TwoLinkArm()
estimator = tarc.estimators.Algebraic(window=0.010)
tdc = tarc.laws.TDC(inertia=[0.1, 0.02], natural_frequency=10.0, period=1e-3, estimator=estimator)
motion = tarc.signals.Quintic(points=[[0.5, -0.8], [1.0, -0.2], [0.3, -0.9]], times=[0.0, 1.0, 2.0])
first = tarc.simulate(arm, tdc, motion, 2.0, initial_torque="rest")
bag = first.save("run.mcap")

recorded = tarc.signals.JointTrajectory(path=bag)
stiffer = replace(tdc, natural_frequency=15.0)
second = tarc.simulate(arm, stiffer, recorded, 2.0, initial_torque="rest")
for name, run in (("TDC", first), ("stiffer, on the bag", second)):
    print(f"{name}: RMS error {1e3 * run.metrics()['rms_error']:.3f} mrad")
difference = abs(second.data["reference"] - first.data["reference"]).max()
print(f"the references differ by {float(difference):.1e} rad at most")
figure = second.plot()
figure.savefig("ros2_bag.png", dpi=110)
