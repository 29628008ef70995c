"""Run a law in a control loop of your own.

The controller gets a position and a reference each period and returns a torque.
Here MuJoCo stands for the robot, a Franka Panda.
"""

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import tarc

robot = tarc.plants.MujocoPlant.from_file("panda", armature=0.1, viscous=1.0, coulomb=1.0)
model, home = robot.copy_model(), robot.home
data = mujoco.MjData(model)
data.qpos[:] = home

law = tarc.laws.TDC(
    inertia=0.1 * robot.inertia(home),
    natural_frequency=20.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
    torque_limit=robot.torque_limits,
    safe_torque="hold",
)
controller = tarc.Controller(law)
controller.reset(data.qpos, initial_torque=robot.gravity_torque(home))

errors = []
for k in range(3000):
    t = k * law.period
    swing, rate = 0.2, 2.0
    reference = home + swing * (1 - np.cos(rate * t))
    velocity = np.full(7, swing * rate * np.sin(rate * t))
    acceleration = np.full(7, swing * rate**2 * np.cos(rate * t))
    data.qfrc_applied[:] = controller.step(data.qpos, reference, velocity, acceleration)
    mujoco.mj_step(model, data)
    errors.append(data.qpos - reference)
print(f"largest error {1e3 * np.max(np.abs(errors)):.2f} mrad, fault: {controller.fault}")

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(law.period * np.arange(len(errors)), 1e3 * np.array(errors), label=robot.joint_names)
axes.set(xlabel="time [s]", ylabel="error [mrad]")
axes.legend(fontsize="small", ncols=4)
figure.savefig("own_loop.png", dpi=110)
