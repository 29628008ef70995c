"""The affine certificate of a robot: what the ball leaves open, and no motion left out of its bounds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import differential_evolution

from law_catalogue import make_tdc
from tampering import replaced, reread, scaled
from tarc.analysis import Workspace, best_inertia_shape, inertia_spread
from tarc.analysis.inertia_rate import InertiaRate
from tarc.analysis.operating_points import OperatingPoint, uncertainty_samples
from tarc.analysis.point_functions import ForceNorm
from tarc.certificates import certify_robot, strengthen_robot
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.plants import TwoLinkArm, load_robot

ARM = TwoLinkArm()
LOADED = ARM.with_parameters({"payload": 2.0})
WORKSPACE = Workspace.from_joint_limits(ARM, speed=2.0)
INERTIA = 0.1 * np.array([[13.448, 5.043], [5.043, 5.043]])  # of the shape with the least spread


@pytest.fixture(scope="module")
def verdicts():
    law = make_tdc(window=6, natural_frequency=40.0, synchronised=True, inertia=INERTIA)
    ball = certify_robot(law, [ARM, LOADED], WORKSPACE, samples=30)
    return ball, strengthen_robot(ball, law, [ARM, LOADED], WORKSPACE, samples=30), law


def test_a_robot_is_certified_where_the_ball_is_not(verdicts):
    ball, affine, _ = verdicts
    assert ball.verdict == "inconclusive"
    assert ball.evidence.method == "ball with a rate"
    assert affine.certified
    assert affine.evidence.method == "affine Lyapunov function"
    assert affine.margin == pytest.approx(0.05, rel=2e-3)
    assert affine.evidence.decay_rate > 0
    assert affine.verdict_in_words == "certified on 30 sampled postures and local search"


def test_a_robot_verifies_and_tampering_shows(verdicts):
    affine = verdicts[1]
    assert reread(affine).verify()
    for name, factor in {
        "period": 2.0,
        "slope": np.nan,
        "nominal_inertia": 1.2,
        "points.max_ratio.inertia": 0.5,
        "points.stiffest_moving.stiffness": 30.0,
        "points.stiffest_moving.damping": 30.0,
        "affine.proof.ratios.stiffness": 0.5,
        "affine.proof.ratios.rate": 0.5,
        "affine.proof.ratios.powers": 0.3,
        "affine.proof.ratios.lead_times": 0.3,
        "affine.proof.multipliers.change": 1e9,
    }.items():
        assert not scaled(affine, name, factor).verify(), name
    assert not replaced(affine, "affine", None).verify()


def test_no_motion_within_the_speed_is_left_out(verdicts):
    """At any share of the speeds and accelerations, in any posture, empty and loaded: ratios, forces and rates."""
    affine = verdicts[1].evidence.affine
    ratios, rng = affine.proof.ratios, np.random.default_rng(8)
    nominal = verdicts[2].M
    points = [
        OperatingPoint(plant, rng.uniform(-np.pi, np.pi, 2), rng.uniform(-2, 2, 2), rng.uniform(-8, 8, 2))
        for plant in (ARM, LOADED)
        for _ in range(400)
    ]
    found = uncertainty_samples(nominal, points)
    values = np.linalg.eigvalsh(found.inertia)
    assert ratios.min_ratio < values.min()
    assert values.max() < ratios.max_ratio
    for power, lead_time, stiffness in zip(ratios.powers, ratios.lead_times, ratios.stiffness, strict=True):
        assert found.force_norms(lead_time, power).max() < stiffness
    speed = np.array([2.0, 2.0])
    for unit, limit in ((nominal, ratios.rate), (None, ratios.relative_rate)):
        assert 0.5 * limit < InertiaRate(unit, speed).values(points).max() < limit


def test_gradients_of_searched_norms_against_differences():
    rng, size = np.random.default_rng(3), 1e-6
    nominal = 0.1 * ARM.inertia([0.0, 2.0])
    for function in (ForceNorm(nominal, 0.05), ForceNorm(nominal, 0.0), InertiaRate(None, np.array([1.0, 2.0]))):
        q = rng.uniform(-3, 3, 2)
        point = OperatingPoint(LOADED, q, np.array([0.7, -0.4]), np.array([1.0, 2.0]))
        number, gradient = function.value_and_gradient(point)
        assert number == pytest.approx(function.values([point])[0])
        for i, direction in enumerate(size * np.eye(2)):
            above, below = (function.values([point._replace(position=q + s * direction)])[0] for s in (1, -1))
            assert gradient[i] == pytest.approx((above - below) / (2 * size), rel=1e-3, abs=1e-4)


def test_what_needs_no_affine_certificate_is_left_as_it_is(verdicts):
    ball, _, law = verdicts
    still = Workspace.from_joint_limits(ARM)
    assert strengthen_robot(ball, law, [ARM, LOADED], still, samples=30) is ball
    refuted = certify_robot(replace(law, inertia=law.M * 100), ARM, WORKSPACE, samples=30)
    assert refuted.verdict == "refuted"
    assert strengthen_robot(refuted, replace(law, inertia=law.M * 100), ARM, WORKSPACE, samples=30) is refuted


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "payload", "window", "natural_frequency", "low", "high"),
    [("ur5e", 5.0, 6, 30.0, 0.0229, 1.1), ("panda", 3.0, 5, 26.0, 0.0214, 1.2)],
)
def test_an_evolution_over_the_workspace_stays_within_what_is_covered(
    name, payload, window, natural_frequency, low, high
):
    """Certified far beyond the ball, at 1 rad/s; and another global search finds nothing that is not covered."""
    plants = [load_robot(name, armature=0.1, payload=mass) for mass in (0.0, payload)]
    space = Workspace.from_joint_limits(plants[0], speed=1.0)
    shape, _ = best_inertia_shape(plants, space, samples=500)
    scale = high / inertia_spread(plants, shape, space, samples=500).max_ratio
    law = TDC(
        inertia=scale * shape,
        natural_frequency=natural_frequency,
        period=1e-3,
        estimator=Algebraic(window=window * 1e-3, degree=3),
        synchronised=True,
    )
    ball = certify_robot(law, plants, space, samples=500)
    best = strengthen_robot(ball, law, plants, space, samples=500)
    assert not ball.certified
    assert best.certified
    assert best.evidence.affine is not None
    ratios, n = best.evidence.affine.proof.ratios, plants[0].n_joints
    assert ratios.min_ratio == pytest.approx(low, rel=0.1)
    bounds = list(zip(space.low, space.high, strict=True)) + [(-1, 1)] * n + [(-4, 4)] * n
    picked = [int(np.flatnonzero(ratios.powers == power)[2]) for power in (0.0, 0.5, 1.0)]

    def excess(variables: np.ndarray, plant) -> float:
        """Return the largest share of any bound that a point takes."""
        found = uncertainty_samples(law.M, [OperatingPoint(plant, *variables.reshape(3, n))])
        values = np.linalg.eigvalsh(found.inertia[0])
        shares = [values[-1] / ratios.max_ratio, ratios.min_ratio / values[0]]
        for i in picked:
            shares.append(found.force_norms(ratios.lead_times[i], ratios.powers[i])[0] / ratios.stiffness[i])
        return float(max(shares))

    largest = []
    for plant in plants:
        evolved = differential_evolution(
            lambda x, plant=plant: -excess(x, plant), bounds, maxiter=60, popsize=4, rng=1, polish=False
        )
        largest.append(-evolved.fun)
    assert 0.85 < max(largest) < 1
