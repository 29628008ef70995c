"""The step by hand that exported C is timed against is the same law."""

import shutil

import pytest

from benchmarks import export
from tarc.export import export_c


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
def test_the_step_by_hand_is_the_exported_law(tmp_path):
    law = export.six_joints()
    export_c(law, tmp_path, name="arm")
    torque, decisions, exported, by_hand = export.times(law, ["gcc", "-O2", "-Wall", "-Wextra", "-Werror"], tmp_path)
    assert torque <= export.TORQUE_TOLERANCE
    assert decisions == 0
    assert 0 < by_hand < 10 * exported
