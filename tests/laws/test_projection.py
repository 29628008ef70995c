"""Adaptive robust control with projection: the regressor, convergence, and bounds."""

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.laws import LawInput

TRUE = plants.TwoLinkArm(masses=(1.4, 0.8), viscous=(2.5, 0.8))
BELIEVED = plants.TwoLinkArm(masses=(1.0, 1.0), viscous=(1.0, 1.0))
BOUNDS = {"masses": [0.3, 2.0], "viscous": [0.0, 4.0]}
EXCITING = signals.Multisine(amplitude=[[0.35, 0.3, 0.25], [0.3, 0.35, 0.2]], frequency=[2.0, 3.3, 5.1])


def projection_law(model: plants.Plant = BELIEVED, **options):
    return make_law(
        laws.ProjectionARC, **{"model": model, "parameter_bounds": BOUNDS, "natural_frequency": 15.0, **options}
    )


def adapted_parameters(run):
    return np.array([run.data[f"adapted_{name}"].values for name in ("masses1", "masses2", "viscous1", "viscous2")])


def test_regressor_is_that_of_slotine_and_li():
    """Their two-link arm by hand, point masses, Applied Nonlinear Control, Section 9.1, with gravity."""
    law = projection_law(parameter_bounds={"masses": [0.3, 2.0]})
    rng = np.random.default_rng(0)
    q, v, rate, acceleration = rng.normal(size=(4, 2))
    constant, Y, M = (np.array(part) for part in law.model_torque(q, v, rate, acceleration))
    c1, c2, s2, c12 = np.cos(q[0]), np.cos(q[1]), np.sin(q[1]), np.cos(q.sum())

    def torque(m1, m2):
        H = np.array([[m1 + m2 * (2 + 2 * c2), m2 * (1 + c2)], [m2 * (1 + c2), m2]])
        C = m2 * s2 * np.array([[-v[1], -(v[0] + v[1])], [v[0], 0.0]])
        gravity = 9.81 * np.array([m1 * c1 + m2 * (c1 + c12), m2 * c12])
        return H @ acceleration + C @ rate + gravity

    np.testing.assert_allclose(Y @ [1.4, 0.8], torque(1.4, 0.8), rtol=1e-9)
    np.testing.assert_allclose(constant[:, 0], 1.0 * rate, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(M, BELIEVED.inertia(q), rtol=1e-12)


def test_parameters_converge_where_they_are_excited():
    law = projection_law(adaptation_gain=1.0, robust_fraction=0.0)
    run = simulate(TRUE, law, EXCITING, 20.0)
    assert run.status.completed
    np.testing.assert_allclose(adapted_parameters(run)[:, -1], [1.4, 0.8, 2.5, 0.8], rtol=0.02)
    early, late = (run.metrics(start_time=start)["rms_error"] for start in (0.0, 18.0))
    assert late < early / 5


def test_projection_keeps_the_bounds():
    """Ones that leave the truth out: p̂ goes to their edge and not beyond."""
    parameter_bounds = {"masses": [0.9, 1.2], "viscous": [0.9, 1.4]}
    run = simulate(TRUE, projection_law(parameter_bounds=parameter_bounds, adaptation_gain=20.0), EXCITING, 5.0)
    adapted = adapted_parameters(run)
    assert run.status.completed
    assert adapted[:2].min() >= 0.9
    assert adapted[:2].max() == 1.2
    assert adapted[2:].min() >= 0.9
    assert adapted[2:].max() == 1.4


def test_robust_term_covers_what_does_not_adapt():
    errors = [
        simulate(TRUE, projection_law(adaptation_gain=0.0, robust_fraction=margin), EXCITING, 4.0).metrics(
            start_time=1.0
        )["rms_error"]
        for margin in (0.0, 1.0)
    ]
    assert errors[1] < errors[0] / 2


def test_with_the_right_parameters_and_nothing_else_it_is_exact():
    """The error obeys (d/dt + ωn)² e = 0 about a point, where C vanishes with the speed."""
    law = projection_law(model=TRUE, adaptation_gain=0.0, robust_fraction=0.0, period=1e-4)
    reference = signals.Sinusoid(amplitude=0.0, frequency=1.0, offset=[0.4, 0.3])
    data = simulate(TRUE, law, reference, 0.6, initial_position=[0.401, 0.3]).data
    time = data["time"].values
    error = data["position"].values[:, 0] - 0.4
    np.testing.assert_allclose(error, 1e-3 * (1 + 15 * time) * np.exp(-15 * time), atol=3e-5)


def test_adaptation_stops_with_the_fault():
    law = projection_law(max_missing=0)
    state, value = law.example()
    for _ in range(3):
        state, _ = law.step(state, LawInput(np.full(2, np.nan), *value[1:]))
    np.testing.assert_array_equal(state.control.adapted, law.nominal)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"parameter_bounds": {"masses": [0.5, 2.0], "lengths": [0.5, 2.0]}},
            "TwoLinkArm are not affine in masses, lengths",
        ),
        ({"parameter_bounds": {"coulomb_width": [0.001, 1.0]}}, "not affine in coulomb_width"),
        ({"parameter_bounds": {"mases": [0.5, 2.0]}}, r"parameter_bounds: got 'mases'.*Did you mean 'masses'\?"),
        ({"parameter_bounds": {"masses": [2.0, 0.5]}}, "bounds of masses: got 2 to 0.5"),
        (
            {"parameter_bounds": {"masses": [1.5, 2.0]}},
            r"bounds of masses: got 1.5 to 2; the model's own is \[1.0, 1.0\]",
        ),
        ({"parameter_bounds": {"masses": [0.5]}}, r"bounds of masses: got shape \(1,\)"),
        ({"parameter_bounds": {}}, "parameter_bounds: got {}; needs least and greatest by name"),
        ({"boundary_layer": 0.0}, "boundary_layer"),
        ({"adaptation_gain": -1.0}, "adaptation_gain"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        projection_law(**{"model": plants.TwoLinkArm(coulomb=0.5), **options})


def test_a_model_without_energies_is_refused():
    robot = plants.MujocoPlant.from_file("ur5e", armature=0.1)
    with pytest.raises(InvalidParameter, match="model: got MujocoPlant.*needs one from energies"):
        projection_law(model=robot, parameter_bounds={"payload": [0.0, 5.0]})
