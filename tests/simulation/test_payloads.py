"""Payloads in a run: several add, and are put down, in symbols and in MuJoCo."""

import numpy as np
import pytest

import tarc
import urdf_text
from law_catalogue import make_tdc
from tarc.signals import ParameterSchedule, Payload, Sinusoid
from tarc.simulation.sampled_inputs import scheduled_plants

PAYLOADS = [Payload(mass=2.0, start_time=0.05, stop_time=0.15), Payload(mass=0.5, start_time=0.10)]
SUM = ParameterSchedule(parameter="payload", times=[0.05, 0.10, 0.15], values=[2.0, 2.5, 0.5])


@pytest.mark.parametrize("backend", ["symbolic", "mujoco"])
def test_payloads_are_the_schedule_of_their_sum(backend, tmp_path):
    (tmp_path / "arm.urdf").write_text(urdf_text.arm())
    plant = tarc.plants.load_robot(tmp_path / "arm.urdf", backend=backend)
    law = make_tdc(inertia=0.1 * plant.inertia(plant.home))
    reference = Sinusoid(amplitude=[0.3, 0.2], frequency=2.0)

    def positions(events):
        return tarc.simulate(plant, law, reference, 0.2, disturbance=events).data["position"].values

    together = positions(PAYLOADS)
    assert np.array_equal(together, positions(SUM))
    single = positions(PAYLOADS[1])
    assert np.array_equal(together[:51], single[:51])
    assert np.abs(together[51:] - single[51:]).max() > 1e-4


def test_the_plants_of_certificates_have_each_sum_once():
    plant = tarc.plants.TwoLinkArm(payload=0.25)
    masses = [(time, float(p.parameters["payload"])) for time, p in scheduled_plants(plant, PAYLOADS)]
    assert masses == [(0.0, 0.25), (0.05, 2.0), (0.1, 2.5), (0.15, 0.5)]


def test_a_schedule_and_a_payload_of_the_same_mass_are_refused():
    law = make_tdc(inertia=[0.15, 0.05])
    with pytest.raises(tarc.core.errors.InvalidParameter, match="two schedules change 'payload'"):
        tarc.simulate(
            tarc.plants.TwoLinkArm(),
            law,
            Sinusoid(amplitude=[0.1, 0.1], frequency=1.0),
            0.1,
            disturbance=[*PAYLOADS, SUM],
        )
