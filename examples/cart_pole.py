"""Move a cart whose pole swings freely.

The file has a motor on the rail and none on the pivot, so the pole is passive: it is simulated, but no torque acts on
it and the law does not see it. The disturbance is what the pole does to the cart.
"""

import warnings
from pathlib import Path

import matplotlib.pyplot as plt

import tarc

Path("cart.xml").write_text("""
<mujoco>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.05" mass="1"/>
      <body name="pole">
        <joint name="pivot" axis="0 1 0" damping="0.005"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.01" mass="0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="rail" ctrlrange="-30 30"/></actuator>
</mujoco>
""")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", tarc.RobotFileWarning)  # it names the passive joint
    cart = tarc.plants.load_robot("cart.xml")
law = tarc.laws.TDC(
    inertia=0.5 * cart.mean_inertia([[0.0]]),
    natural_frequency=10.0,
    period=1e-3,
    synchronised=True,
    estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
)
path = tarc.signals.Quintic(points=[[0.0], [0.5], [0.5], [0.0]], times=[0.0, 1.0, 3.0, 4.0])
run = tarc.simulate(cart, law, path, 6.0, sensor=tarc.signals.Encoder(resolution=1e-5))
print(run.status, run.metrics()["rms_error"], cart.passive_joints)

figure, (above, below) = plt.subplots(2, sharex=True, layout="constrained")
above.plot(run.data["time"], run.data["reference"], "k--", label="reference")
above.plot(run.data["time"], run.data["position"], label="cart")
above.set_ylabel("rail [m]")
above.legend()
below.plot(run.data["time"], run.data["passive_position"])
below.set_ylabel("pivot [rad]")
below.set_xlabel("time [s]")
figure.savefig("cart_pole.png", dpi=110)
