"""`simulate` warns of a design that is shown to be unstable, with the remedy, and of no other."""

import warnings

import numpy as np
import pytest

import tarc
from law_catalogue import make_tdc

ARM = tarc.plants.TwoLinkArm()
SWING = tarc.signals.Sinusoid(amplitude=[0.3, 0.3], frequency=[2.0, 2.5])


def tdc_with_inertia_share(share, **options):
    return make_tdc(inertia=share * ARM.inertia([0.0, 0.0]), **options)


def test_names_posture_range_and_remedy():
    with pytest.warns(
        tarc.DesignWarning, match="stable from 0.00486 to 0.2616. Use a smaller inertia, a shorter window"
    ) as caught:
        run = tarc.simulate(ARM, tdc_with_inertia_share(0.9), SWING, 0.5)
    assert caught[0].filename == __file__
    assert not run.status.completed
    assert "held at rest at q = (" in str(caught[0].message)


@pytest.mark.parametrize(
    ("options", "delay", "message"),
    [
        ({"share": 1e-3}, 0, "Use a larger inertia or a lower natural frequency"),
        ({"share": 4.0, "synchronised": True}, 0, "a shorter window or a lower natural frequency"),
        ({"share": 0.05, "natural_frequency": 200.0}, 60, "No ratio is stable: lower the natural frequency"),
    ],
)
def test_the_remedy_fits_the_fault(options, delay, message):
    with pytest.warns(tarc.DesignWarning, match=message):
        tarc.simulate(ARM, tdc_with_inertia_share(**options), SWING, 0.1, computation_delay=delay)


def test_a_sound_design_draws_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = tarc.simulate(ARM, tdc_with_inertia_share(0.05), SWING, 1.0)
    assert run.status.completed


def test_a_payload_to_come_counts_from_when_it_comes():
    """A lighter second link raises the ratio past its range, but only in the second half."""
    design = tdc_with_inertia_share(0.06)
    lighter = tarc.signals.ParameterSchedule(parameter="masses", times=[0.5], values=[[0.2, 0.1]])
    with pytest.warns(tarc.DesignWarning, match="smaller inertia"):
        tarc.simulate(ARM, design, SWING, 1.0, disturbance=lighter)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tarc.simulate(ARM, design, SWING, 0.4, disturbance=lighter)


def test_scheduled_plants_have_the_changes_up_to_each_time():
    from tarc.simulation.sampled_inputs import scheduled_plants

    events = [
        tarc.signals.Payload(mass=2.0, start_time=1.0),
        tarc.signals.ParameterSchedule(parameter="viscous", times=[0.0, 3.0], values=[1.0, 2.0]),
    ]
    robot = tarc.plants.MujocoPlant.from_file("ur5e", armature=0.1)
    changes = scheduled_plants(robot, events)
    assert [begin for begin, _ in changes] == [0.0, 1.0, 3.0]
    assert [float(plant.parameters["payload"]) for _, plant in changes] == [0.0, 2.0, 2.0]
    assert [plant.parameters["viscous"][0] for _, plant in changes] == [1.0, 1.0, 2.0]
    loaded = tarc.plants.MujocoPlant.from_file("ur5e", armature=0.1, payload=2.0)
    np.testing.assert_allclose(changes[2][1].inertia(robot.home), loaded.inertia(robot.home), rtol=1e-12)
    assert float(robot.parameters["payload"]) == 0.0
