"""How large an error a law recovers from: a region of attraction of the nonlinear loop, and runs from its boundary.

The certificate bounds the error of a two-link arm along a motion, with an encoder and a torque that nobody knows.
The runs start anywhere on the boundary of the region, and the unknown torque changes as fast as is allowed.
"""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

import tarc
from tarc.certificates import certify_region
from tarc.signals import Encoder, Quintic
from tarc.signals.disturbances import Disturbance

BITS, TORQUE_RATE, DURATION = 17, 5.0, 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangle(Disturbance):
    """A torque [N m] that changes at a steady rate, up and down in turn."""

    frequency: float

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return a triangular wave between −1 and 1."""
        return 2 / np.pi * np.arcsin(np.sin(self.frequency * times))


arm = tarc.plants.TwoLinkArm(viscous=0.2)
reference = Quintic(points=[[0.2, 0.8], [0.8, 1.4], [0.2, 0.8]], times=[0.0, 2.0, 4.0])
law = tarc.laws.TDC(
    inertia=0.08 * arm.inertia([0.0, 1.1]),
    natural_frequency=20.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.006, degree=2),
)
certificate = certify_region(
    law,
    arm,
    reference,
    DURATION,
    max_error=0.3,
    measurement_error=np.pi / 2**BITS,
    torque_rate=TORQUE_RATE,
    samples=200,
)
print(certificate.explain())
evidence = certificate.evidence
assert evidence.proof is not None
values, vectors = np.linalg.eigh(evidence.nominal_inertia)
root = vectors * values**0.5 @ vectors.T

figure, (plane, time) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
angles = np.linspace(0, 2 * np.pi, 200)
circle = np.linalg.solve(root, np.vstack([np.cos(angles), np.sin(angles)]))
sizes = {
    "tube, never left": evidence.proof.tube.error,
    "start": evidence.start_error,
    "end": evidence.final_error,
}
for colour, (label, size) in zip(("C3", "C0", "C2"), sizes.items(), strict=True):
    plane.plot(*(1e3 * size * circle), color=colour, label=label)
    time.axhline(size, color=colour, ls="--")
for i, angle in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False)):
    offset = 0.999 * evidence.start_error * np.linalg.solve(root, [np.cos(angle), np.sin(angle)])
    frequency = (3.0, 12.0, 20.0, 40.0)[i % 4]
    sign = np.array([1.0, (-1.0) ** i])
    run = tarc.simulate(
        arm,
        law,
        reference,
        DURATION,
        sensor=Encoder(bits=BITS),
        initial_position=reference.sample([0.0])[0][:, 0] + offset,
        initial_torque="rest",
        disturbance=Triangle(amplitude=sign * TORQUE_RATE * np.pi / 2 / frequency, frequency=frequency),
        progress=False,
    )
    error = (run.data["position"] - run.data["reference"]).values
    plane.plot(*(1e3 * error.T), color="0.4", lw=0.6)
    time.semilogy(run.data["time"], np.linalg.norm(error @ root, axis=1), color="0.4", lw=0.6)
    assert np.all(np.abs(error) <= evidence.tube_errors)
plane.set_xlabel("error of joint 1 [mrad]")
plane.set_ylabel("error of joint 2 [mrad]")
plane.legend(fontsize="small", loc="upper right")
time.set_xlabel("time [s]")
time.set_ylabel("‖M̂^½ e‖ [rad kg^½ m]")
time.set_ylim(1e-5, 0.2)
for axes in (plane, time):
    axes.grid(alpha=0.3)
figure.savefig("largest_error.png", dpi=110)
