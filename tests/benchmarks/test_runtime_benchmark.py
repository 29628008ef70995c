"""Nonsense in samples and packets, as in the benchmark of the loop on the machine, but less of it."""

import pytest

from benchmarks import runtime


def test_no_sample_makes_a_torque_that_is_not_finite_or_beyond_its_limits():
    read, violations, ended = runtime.senseless_runs(6000)
    assert read >= 6000
    assert violations == 0
    assert sum(ended.values()) >= 2


def test_every_malformed_packet_is_counted_and_none_is_a_position():
    sent, malformed, counts, is_valid = runtime.senseless_packets(3000)
    assert 0.7 * sent < malformed < 0.95 * sent
    assert counts["malformed"] == malformed
    assert counts["strangers"] == counts["stale"] == 0
    assert is_valid


@pytest.mark.slow
def test_the_loop_in_c_runs_the_benchmark(tmp_path):
    text = runtime.loop_in_c(runtime.robot_model(), tmp_path, 0.5)
    assert "periods missed" in text
