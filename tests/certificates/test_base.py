"""Verification of certificates whose matrices do not fit together."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from law_catalogue import make_tdc
from tarc.analysis import Workspace
from tarc.certificates import certify_constant_ratio, certify_robot
from tarc.certificates.base import Certificate, LoopMatrices
from tarc.core.errors import InvalidParameter
from tarc.plants import TwoLinkArm

ARM = TwoLinkArm()


@pytest.fixture(scope="module")
def constant_ratio():
    return certify_constant_ratio(make_tdc(), (0.02, 0.1))


def with_evidence(certificate: Certificate, **changes: Any) -> Certificate:
    return replace(certificate, evidence=replace(certificate.evidence, **changes))


def with_loop(certificate: Certificate, **changes: Any) -> Certificate:
    (loop,) = certificate.evidence.loops
    matrices = {"A": loop.A, "B": loop.B, "C": loop.C} | changes
    return with_evidence(certificate, loops=(LoopMatrices(**matrices),))


def test_matrices_of_other_shapes_do_not_verify(constant_ratio):
    """A column too many is an error of NumPy."""
    (loop,) = constant_ratio.evidence.loops
    tampered = with_loop(constant_ratio, C=np.ones((1, loop.C.shape[1] + 1)))
    with pytest.raises(ValueError, match="dimensions"):
        tampered.evidence.judge()
    assert not tampered.verify()


def test_a_loop_of_two_inputs_does_not_verify(constant_ratio):
    """Two inputs are those of two joints, which have twice as many positions."""
    (loop,) = constant_ratio.evidence.loops
    tampered = with_loop(constant_ratio, B=np.hstack([loop.B, loop.B]), C=np.vstack([loop.C, loop.C]))
    with pytest.raises(ValueError, match="not those of a robot"):
        tampered.evidence.judge()
    assert not tampered.verify()


def test_a_singular_inertia_does_not_verify():
    law = make_tdc(inertia=0.05 * ARM.inertia([0.0, 1.5]))
    certificate = certify_robot(law, ARM, Workspace.box([-0.5, 1.0], [0.5, 2.0]), samples=50)
    points = certificate.evidence.points
    singular = replace(points, min_ratio=replace(points.min_ratio, inertia=np.zeros((2, 2))))
    tampered = with_evidence(certificate, points=singular)
    with pytest.raises(np.linalg.LinAlgError):
        tampered.evidence.judge()
    assert not tampered.verify()


def test_unknown_verdict(constant_ratio):
    with pytest.raises(InvalidParameter, match="verdict: got 'sure'; allowed: certified, refuted, inconclusive"):
        replace(constant_ratio, verdict="sure")
