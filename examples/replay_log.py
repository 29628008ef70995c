"""Replay the log of a robot whose recorder is slower than its clock.

The log is simulated here: some samples are in no row, others are in two, and the stamps are late by up to 0.4 ms. The
replay finds the true time of each row again. On these times it measures delay and noise of the estimator and the torque
that a model explains. `tarc replay` does the same for the log of your robot.
"""

import numpy as np

import tarc

arm = tarc.plants.load_robot("ur5e", joints=["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"], armature=0.1)
law = tarc.laws.TDC(
    inertia=0.05 * np.diag(np.diag(arm.inertia(arm.home))),
    natural_frequency=15.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.010),
)
motion = tarc.signals.Multisine(amplitude=[0.2, 0.15, 0.25], frequency=[1.9, 3.1, 4.3], offset=arm.home)
sensor = tarc.signals.Encoder(noise=2e-6)
run = tarc.simulate(arm, law, motion, 5.0, sensor=sensor, initial_torque="rest", native=False)

rng = np.random.default_rng(0)
read_times = 1.02e-3 * np.arange(4800) + 0.3e-3 * rng.random(4800)
ticks = np.maximum.accumulate((read_times / 1e-3 - 0.1 * rng.random(4800)).astype(int))
log = tarc.signals.RobotLog(
    times=read_times + 0.1e-3 * rng.random(4800),
    position=run.data["measured_position"].values[ticks],
    torque=run.data["torque"].values[ticks],
    joint_names=tuple(arm.joint_names),
    label="recorded",
)
found = tarc.replay(log, arm, law=law, start_time=0.5)
timing, window = found.timing, found.windows[0]
print(f"stale {timing.stale:.1%}, missing {timing.missing:.1%}, residual {1e6 * np.max(timing.residual):.1f} µrad")
print(f"delay {1e3 * window.delay.mean():.2f} ms, predicted {1e3 * window.predicted_delay:.2f} ms")
if found.model is not None:
    print(f"explained {found.model.explained.round(4)}")
found.save_report("replay.html")
figure = found.plot()
figure.savefig("replay_log.png", dpi=110)
