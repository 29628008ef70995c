"""Many runs in machine code: equal to `simulate`, and bit for bit whatever runs are side by side."""

from typing import Any

import numpy as np
import pytest

from law_catalogue import concrete_laws, make_law
from tarc import estimators, laws, plants, signals, simulate
from tarc.control.digital_controller import DigitalController
from tarc.core.errors import UnsupportedLaw
from tarc.plants.gearbox import Gearbox
from tarc.simulation.batch import BatchLoop
from tarc.simulation.batch_inputs import LoopCase
from tarc.simulation.integration import Integration

ARM = plants.TwoLinkArm(viscous=(0.5, 0.5), coulomb=(1.0, 0.5))
REFERENCE = signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[2.0, 3.0], offset=[0.0, 1.5])
METHOD = Integration("Runge–Kutta", 2)
START = 0.1


@pytest.fixture(autouse=True, scope="module")
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def make_case(law, *, plant: Any = ARM, sensor=None, limits=None, **options):
    controller = DigitalController(sensor or signals.Encoder(bits=16), law, torque_limits=limits)
    return LoopCase(
        **{"plant": plant, "controller": controller, "reference": REFERENCE, "initial_torque": "rest"} | options
    )


def tarc_law(**options):
    gains: dict[str, Any] = {"boundary_layer": 0.015, "max_gain": 5.0, "natural_frequency": 15.0, **options}
    return make_law(laws.TARC, **gains)


def robots(count, law=None, **options):
    """Arms with other payload, friction and noise."""
    rng, law = np.random.default_rng(0), law or tarc_law()
    return [
        make_case(
            law,
            sensor=signals.Encoder(bits=16, noise=rng.uniform(1e-5, 1e-4)),
            plant_parameters={"payload": rng.uniform(0, 1), "viscous": (rng.uniform(0.3, 0.8), 0.5)},
            **options,
        )
        for _ in range(count)
    ]


def simulated(case, duration, seed, **options):
    controller = case.controller
    return simulate(
        case.actual_plant,
        controller.law,
        case.reference,
        duration,
        sensor=controller.sensor,
        disturbance=case.events,
        drive=case.drive,
        jitter=case.jitter,
        torque_limits=controller.torque_limits,
        computation_delay=controller.computation_delay,
        initial_torque=case.initial_torque,
        substeps=METHOD.substeps,
        seed=seed,
        native=False,
        **options,
    )


def run_all(batch, cases, seeds=None):
    return batch.run(cases, batch.sample(cases, range(len(cases)) if seeds is None else seeds))


def check_like_simulate(batch, cases, duration, rtol=1e-9):
    result = run_all(batch, cases)
    for i, case in enumerate(cases):
        run = simulated(case, duration, i)
        measures = run.metrics_or_none(START)
        assert result.completed[i] == run.status.completed
        assert set(measures) == set(result.measures) or not measures
        for name, values in result.measures.items():
            np.testing.assert_allclose(values[i], measures.get(name, np.nan), rtol=rtol, atol=1e-12, err_msg=name)
    return result


def check_same_bits(result, other):
    for name, values in result.measures.items():
        np.testing.assert_array_equal(values, other.measures[name], err_msg=name)
    np.testing.assert_array_equal(result.completed, other.completed)
    np.testing.assert_array_equal(result.end_time, other.end_time)


@pytest.mark.slow
def test_runs_are_those_of_simulate_and_the_same_at_every_width():
    cases = robots(9)
    results = [
        run_all(BatchLoop(cases[:2], METHOD, 0.3, metrics_start=START, lanes=lanes), cases) for lanes in (1, 4, 8)
    ]
    for result in results[1:]:
        check_same_bits(results[0], result)
    check_like_simulate(BatchLoop(cases[:2], METHOD, 0.3, metrics_start=START), cases[:2], 0.3)


def test_results_do_not_depend_on_the_chunks():
    cases = robots(5)
    batch = BatchLoop(cases[:2], METHOD, 0.2)
    whole = run_all(batch, cases)
    parts = [run_all(batch, cases[start:stop], range(start, stop)) for start, stop in ((0, 3), (3, 5))]
    for name, values in whole.measures.items():
        np.testing.assert_array_equal(values, np.concatenate([part.measures[name] for part in parts]))


def test_what_varies_is_an_argument():
    batch = BatchLoop(robots(2), METHOD, 0.1)
    assert set(batch.varying) == {"plant.payload", "plant.viscous[0]", "0.sensor.noise"}
    assert batch.inputs.own == ["noise"]
    np.testing.assert_allclose(
        sorted(batch.arguments(robots(3)[2]))[1:],
        sorted([robots(3)[2].plant_parameters["payload"], robots(3)[2].plant_parameters["viscous"][0]]),
    )


@pytest.mark.slow
def test_a_diverged_lane_keeps_its_measures():
    """A heavy load throws one arm off; its measures and time are those of its own run, beside arms that go on."""
    law = tarc_law(natural_frequency=30.0, torque_limit=40.0)
    cases = [make_case(law, plant_parameters={"payload": mass}) for mass in (0.1, 6.0, 0.3, 0.2)]
    batch = BatchLoop(cases[:2], METHOD, 1.0, metrics_start=START, divergence_threshold=0.5)
    result = run_all(batch, cases)
    assert result.completed.tolist() == [True, False, True, True]
    run = simulated(cases[1], 1.0, 1, divergence_threshold=0.5)
    assert result.end_time[1] == run.status.divergence_time
    for name, value in run.metrics(START).items():
        np.testing.assert_allclose(result.measures[name][1], value, rtol=1e-9, err_msg=name)
    alone = BatchLoop(cases[:2], METHOD, 1.0, metrics_start=START, divergence_threshold=0.5, lanes=1)
    check_same_bits(result, run_all(alone, cases))


def test_a_run_that_ends_before_the_measures_has_none():
    law = tarc_law(natural_frequency=30.0, torque_limit=40.0)
    cases = [make_case(law, plant_parameters={"payload": mass}) for mass in (6.0, 7.0)]
    result = run_all(BatchLoop(cases, METHOD, 1.0, metrics_start=0.9, divergence_threshold=0.5), cases)
    assert not np.any(result.completed)
    assert all(np.all(np.isnan(values)) for values in result.measures.values())
    assert np.all(result.end_time < 0.9)


@pytest.mark.slow
def test_gains_of_the_law_vary():
    """Gains enter matrices that are computed when a law is built."""
    cases = [
        make_case(tarc_law(natural_frequency=w, boundary_layer=e, rise_rate=r))
        for w, e, r in ((12.0, 0.01, 3e3), (15.0, 0.02, 2e3), (13.5, 0.03, 2.2e3))
    ]
    batch = BatchLoop(cases, METHOD, 0.2, metrics_start=START)
    check_like_simulate(batch, cases, 0.2)
    assert batch.covers(make_case(tarc_law(natural_frequency=14.0)))
    assert not batch.covers(make_case(tarc_law(min_gain=0.02)))


def test_counts_make_other_loops():
    wide = estimators.Algebraic(window=0.012, degree=2)
    with pytest.raises(UnsupportedLaw, match="which is no number"):
        BatchLoop([make_case(tarc_law()), make_case(tarc_law(estimator=wide))], METHOD, 0.1)


VARIED = {
    "resolution": [{"sensor": signals.Encoder(resolution=step)} for step in (1e-4, 2e-4)],
    "limits": [
        {"limits": signals.TorqueLimits(magnitude=m, rate=r, resolution=0.01)} for m, r in ((40.0, 4e3), (45.0, 5e3))
    ],
    "drive": [{"drive": signals.Drive(time_constant=c)} for c in (0.001, 0.0012)],
    "step": [{"events": (signals.StepDisturbance(amplitude=a, start_time=0.1),)} for a in (1.0, 2.0)],
    "payload": [{"events": (signals.Payload(mass=m, start_time=0.15),)} for m in (1.0, 2.0)],
    "jitter": [{"jitter": j} for j in (0.2, 0.3)],
    "timing": [{"sensor": signals.Encoder(noise=1e-5, timing_jitter=j, dropout=0.02)} for j in (0.2, 0.3)],
    "reference": [{"reference": signals.Sinusoid(amplitude=a, frequency=[2.0, 3.0])} for a in (0.2, 0.3)],
    "start": [{"initial_position": [0.01, x]} for x in (1.5, 1.51)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIED)
def test_parts_vary(name):
    cases = [make_case(tarc_law(), **options) for options in VARIED[name]]
    if name == "start":
        cases = [
            make_case(tarc_law(), initial_velocity=v, **options)
            for v, options in zip((0, 0.1), VARIED[name], strict=True)
        ]
        result = run_all(BatchLoop(cases, METHOD, 0.3, metrics_start=START), cases)
        assert result.measures["peak_error"][0] != result.measures["peak_error"][1]
        return
    batch = BatchLoop(cases, METHOD, 0.3, metrics_start=START)
    check_like_simulate(batch, cases, 0.3, rtol=1e-6)
    check_same_bits(run_all(batch, cases), run_all(BatchLoop(cases, METHOD, 0.3, metrics_start=START, lanes=1), cases))


@pytest.mark.slow
@pytest.mark.parametrize("kind", concrete_laws(), ids=lambda kind: kind.__name__)
def test_every_law(kind):
    """Without quantisation, so that no last bit decides."""
    law = make_law(kind)
    cases = [
        make_case(law, plant_parameters={"payload": m}, sensor=signals.Encoder(noise=1e-6)) for m in (0.1, 0.3, 0.2)
    ]
    batch = BatchLoop(cases[:2], METHOD, 0.2, metrics_start=START)
    alone = BatchLoop(cases[:2], METHOD, 0.2, metrics_start=START, lanes=1)
    check_same_bits(run_all(batch, cases), run_all(alone, cases))
    check_like_simulate(batch, cases, 0.2, rtol=1e-6)


PLANTS = {
    "three links": (plants.NLinkArm(), {"payload": 0.1}, {"payload": 0.3}),
    "masses": (plants.MassSpringDamper(), {}, {}),
    "gearbox": (
        Gearbox(plant=ARM, stiffness=2000.0, motor_inertia=0.05, breakaway=0.3, coulomb=0.2),
        {"gearbox_stiffness": (2000.0, 1900.0)},
        {"gearbox_stiffness": (2100.0, 1900.0)},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_plants(name):
    plant, *parameters = PLANTS[name]
    n = plant.n_joints
    law = make_law(laws.TARC, n)
    reference = signals.Sinusoid(amplitude=[0.1] * n, frequency=2.0, offset=0.5)
    cases = [make_case(law, plant=plant, reference=reference, plant_parameters=one) for one in parameters]
    batch = BatchLoop(cases, METHOD, 0.2, metrics_start=START)
    check_like_simulate(batch, cases, 0.2, rtol=1e-6)


@pytest.mark.slow
def test_robot_from_a_file():
    arm = plants.load_robot("ur5e", armature=0.1, viscous=1.0, coulomb=2.0)
    law = make_law(laws.TARC, 6, inertia=0.08 * arm.inertia(arm.home))
    reference = signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=arm.home)
    cases = [make_case(law, plant=arm, reference=reference, plant_parameters={"payload": m}) for m in (0.5, 1.0, 2.0)]
    batch = BatchLoop(cases, METHOD, 0.2, metrics_start=START)
    check_like_simulate(batch, cases, 0.2, rtol=1e-6)
