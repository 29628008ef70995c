"""A law in a robot loop of your own: here MuJoCo stands for the robot, the loop is yours."""

import mujoco
import numpy as np

import tarc

robot = tarc.plants.MujocoPlant.from_file("panda", armature=0.1, viscous=1.0, coulomb=1.0)
model, home = robot.copy_model(), robot.home
data = mujoco.MjData(model)
data.qpos[:] = home

law = tarc.laws.TDC(
    inertia=0.1 * robot.inertia(home),
    bandwidth=20.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
    torque_limit=robot.torque_limit,
    safe_torque="hold",
)
controller = tarc.Controller(law)
controller.reset(data.qpos, torque=robot.gravity_torque(home))

worst = 0.0
for k in range(3000):
    t = k * law.period
    swing, rate = 0.2, 2.0
    reference = home + swing * (1 - np.cos(rate * t))
    velocity = np.full(7, swing * rate * np.sin(rate * t))
    acceleration = np.full(7, swing * rate**2 * np.cos(rate * t))
    data.qfrc_applied[:] = controller.step(data.qpos, reference, velocity, acceleration)
    mujoco.mj_step(model, data)
    worst = max(worst, float(np.max(np.abs(data.qpos - reference))))
print(f"largest error {1e3 * worst:.2f} mrad, fault: {controller.fault}")
