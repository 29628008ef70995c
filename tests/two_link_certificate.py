"""A two-link arm with and without load, and its certificate by a Lyapunov function, for proofs of a robot."""

from typing import Any

import numpy as np

from law_catalogue import make_tdc
from tarc.analysis import Workspace
from tarc.certificates import certify_robot, strengthen_robot
from tarc.plants import TwoLinkArm

ARM = TwoLinkArm()
LOADED = ARM.with_parameters({"payload": 2.0})
WORKSPACE = Workspace.from_joint_limits(ARM, speed=2.0)
INERTIA = 0.1 * np.array([[13.448, 5.043], [5.043, 5.043]])


def strengthened(natural_frequency: float) -> tuple[Any, Any]:
    """Return the certificate and the law."""
    law = make_tdc(window=6, natural_frequency=natural_frequency, synchronised=True, inertia=INERTIA)
    ball = certify_robot(law, [ARM, LOADED], WORKSPACE, samples=30)
    return strengthen_robot(ball, law, [ARM, LOADED], WORKSPACE, samples=30), law
