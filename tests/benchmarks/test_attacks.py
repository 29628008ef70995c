"""The attacks of the benchmark on an arm with a load: they break what is unstable, and not what is certified."""

import json

import pytest

from benchmarks import attacks


@pytest.mark.slow
def test_no_motion_breaks_a_certified_arm_with_a_load():
    shape = json.loads(attacks.FIRST_DESIGNS.read_text(encoding="utf-8"))["UR5e"]
    case = attacks.Case(attacks.ARMS["UR5e"], attacks.Shape(**shape))
    certificate = case.certificate(24.0)
    assert certificate.certified
    assert certificate.evidence.affine is not None
    assert case.attack(24.0, 320).broken == 0
    assert case.run(24.0, 10) == 0
    assert case.attack(1.3 * case.frozen_limit(), 64, until_broken=True).broken
