"""The form of stiffness and damping with their power: derivatives, motions within a period, and a robot by it."""

from dataclasses import replace

import numpy as np
import pytest

import check_certificate as tool
from law_catalogue import make_tdc
from reference.motion_attacks import MotionAttacker
from tampering import replaced, reread, scaled
from tarc.analysis import Workspace
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import OperatingPoint, UncertaintySamples, uncertainty_samples
from tarc.certificates import certify_robot, prove_robot, strengthen_robot
from tarc.certificates.affine_form import RatioSet, Rows, period_form_polynomial
from tarc.certificates.force_form import ForceForm, ForcePoints, FormValue
from tarc.numerics.matrix_polynomial import evaluate
from tarc.plants import TwoLinkArm

ARM = TwoLinkArm(viscous=0.5)
LOADED = ARM.with_parameters({"payload": 2.0})
ROUGH = ARM.with_parameters({"viscous": 10.0})
WORKSPACE = Workspace.from_joint_limits(ARM, speed=2.0)
INERTIA = 0.1 * np.array([[13.448, 5.043], [5.043, 5.043]])
FORM = ForceForm(torque=1.0, energy=5.0, power=20.0, position=4e4, velocity=1e3, split=20.0)


def test_derivatives_against_differences():
    rng, size = np.random.default_rng(3), 1e-6
    function = FormValue(INERTIA, FORM)
    for plant in (ARM, LOADED):
        q = rng.uniform(-3, 3, 2)
        point = OperatingPoint(plant, q, np.array([0.7, -0.4]), np.array([1.0, 2.0]))
        value, gradient = function.value_and_gradient(point)
        assert value == pytest.approx(function.values([point])[0])
        for i, direction in enumerate(size * np.eye(2)):
            above, below = (function.values([point._replace(position=q + s * direction)])[0] for s in (1, -1))
            assert gradient[i] == pytest.approx((above - below) / (2 * size), rel=1e-3, abs=1e-5)


def test_margin_is_the_growth_that_the_form_covers():
    points = [OperatingPoint(ARM, np.array([0.3, 1.0]), np.array([1.0, -1.0]), np.array([4.0, 4.0]))]
    samples = uncertainty_samples(INERTIA, points)
    form = FORM.loosened(float(FORM.grown(0.1).values(samples).max()))
    assert form.margin(samples) == pytest.approx(0.1, abs=1e-3)
    grown = UncertaintySamples(1.1 * samples.inertia, 1.1**2 * samples.stiffness, 1.1**2 * samples.damping)
    assert form.values(grown) == pytest.approx(form.grown(0.1).values(samples))
    assert FORM.loosened(0.1 * float(FORM.values(samples)[0])).margin(samples) == -1


def period_of(rng, period):
    """One period of ẍ = E(t)(v + k), k = −G(t) x − D(t) ẋ, by short steps: its form and its moments."""
    n, steps = 2, 400
    times = (np.arange(steps) + 0.5) * period / steps
    J0, dJ = np.diag(np.exp(rng.uniform(-1, 3, n))), rng.standard_normal((n, n)) * rng.choice([0.0, 3.0])
    J = J0 + (times - period / 2)[:, None, None] * (dJ + dJ.T)
    E = np.linalg.inv(J)
    G, D = rng.uniform(0, 300) * rng.standard_normal((n, n)), rng.uniform(0, 30) * rng.standard_normal((n, n))
    G, D = G + 0 * E, D + (times - period / 2)[:, None, None] * 100 * rng.standard_normal((n, n))
    samples = UncertaintySamples(E, E @ G, E @ D)
    form = replace(FORM, torque=rng.uniform(0.1, 1), energy=rng.uniform(0, 5), power=rng.uniform(0, 40))
    form = form.loosened(float(form.values(samples).max()))
    rates = np.linalg.eigvals(E @ (dJ + dJ.T)).real
    values = np.linalg.eigvalsh(E)
    ratios = RatioSet(
        min_ratio=float(values.min()),
        max_ratio=float(values.max()),
        rate=float(np.abs(np.linalg.eigvalsh(dJ + dJ.T)).max()),
        relative_rate=float(np.abs(rates).max()),
        period=period,
        intersample=True,
        powers=np.zeros(0),
        lead_times=np.zeros(0),
        stiffness=np.zeros(0),
        shares=np.zeros(0),
        form=form,
    )
    x, rate = worst_state(form, samples.at(np.array([np.argmax(form.values(samples))])))
    v = rng.choice([0.0, 30.0, 300.0]) * rng.standard_normal(n)
    start, step, forces = (x, rate), period / steps, []
    for i in range(steps):
        middle, speed = x + step / 2 * rate, rate
        k = -G[i] @ middle - D[i] @ speed
        for _ in range(3):
            speed = rate + step / 2 * E[i] @ (v + k)
            k = -G[i] @ middle - D[i] @ speed
        acceleration = E[i] @ (v + k)
        x, rate = x + step * rate + step**2 / 2 * acceleration, rate + step * acceleration
        forces.append(E[i] @ k)
    mean = E.mean(axis=0)
    eigenvalues, basis = np.linalg.eigh(mean)
    first = 12**0.5 * (period / 2 - times) / period
    f = np.array(forces) @ np.linalg.inv(mean)
    moments = [f.mean(axis=0), (first[:, None] * f).mean(axis=0), (first[:, None] * ((E - mean) @ v)).mean(axis=0)]
    k0, k1, c, v, x, rate = (basis.T @ part for part in (*moments, v, *start))
    return ratios, form, eigenvalues, [k0, k1, c, v, x, rate * period]


def worst_state(form, sample):
    """x and ẋ at which the left side of a form is largest over the right side."""
    n = sample.inertia.shape[1]
    R = np.linalg.solve(sample.inertia[0], np.hstack([sample.stiffness[0], sample.damping[0]]))
    left = R.T @ (form.torque * R + form.energy * sample.inertia[0] @ R)
    left[n:] -= form.power * R
    left[:, n:] -= form.power * R.T
    scales = np.repeat([form.position**-0.5, form.velocity**-0.5], n)
    state = scales * np.linalg.eigh(left * np.outer(scales, scales))[1][:, -1]
    return state[:n], state[n:]


def margin_of(ratios, form, eigenvalues, signals):
    """Right less left side of the form over a period, over the right one."""
    total, size = 0.0, 0.0
    for i, ratio in enumerate(eigenvalues):
        k0, k1, c, v, x, rate = (np.array([[part[i]]]) for part in signals)
        none = np.zeros((0, 1))
        rows = Rows(none, (none, none), (none, none), none, v, x, rate, np.vstack([k0, k1]), c, none, v + k0, 0 * v)
        total += evaluate(period_form_polynomial(rows, ratios, form), ratio).item() / ratio
        size += form.position * x.item() ** 2 + form.velocity * (rate.item() / ratios.period) ** 2
    return total / size


def test_what_it_says_of_a_period_holds_on_motions_with_all_that_changes_within():
    """By integrating the equations of motion; in a short period hardly anything is left over."""
    rng = np.random.default_rng(1)
    least = [min(margin_of(*period_of(rng, period)) for _ in range(10)) for period in (1e-5, 3e-3)]
    assert min(least) > 0
    assert least[0] < 0.02


def test_points_make_a_form_that_covers_them():
    rng = np.random.default_rng(0)
    points = [
        OperatingPoint(plant, *rng.uniform(-1, 1, (3, 2)) * [[3.0], [2.0], [8.0]])
        for plant in (ARM, LOADED)
        for _ in range(50)
    ]
    samples = uncertainty_samples(INERTIA, points).with_friction()
    cover = ForcePoints(samples, 0.05)
    form = cover.covering(np.array([1.0, 0.5, 1.0, 0.1, 0.1]))
    assert form.grown(0.05).values(samples).max() == pytest.approx(1.0)
    worst = int(np.argmax(form.values(samples)))
    assert worst in cover.active
    units = cover.units.of_coefficients
    total = sum(x * part for x, part in zip(form.coefficients / units, cover.forms(worst), strict=True))
    assert abs(np.linalg.eigvalsh(total)[0]) < 1e-6 * np.linalg.norm(total)
    for lacking in ([1.0, 0.5, 1.0, 0.1, 0.0], [0.0] * 5):  # as a solver returns them where it fails
        form = cover.covering(np.array(lacking))
        assert form.is_valid()
        assert form.grown(0.05).values(samples).max() <= 1.0


@pytest.fixture(scope="module")
def verdicts():
    """Where norms of the forces do not suffice."""
    law = make_tdc(window=6, natural_frequency=59.0, synchronised=True, inertia=INERTIA)
    plants = [ROUGH, ROUGH.with_parameters({"payload": 2.0})]
    ball = certify_robot(law, plants, WORKSPACE, samples=30)
    return ball, strengthen_robot(ball, law, plants, WORKSPACE, samples=30), law, plants


@pytest.mark.slow
def test_a_robot_is_certified_by_it_where_norms_do_not_suffice(verdicts, tmp_path):
    ball, found, law, plants = verdicts
    assert not ball.certified
    assert found.certified
    assert found.evidence.affine.proof.ratios.form is not None  # norms were tried first
    assert found.margin == pytest.approx(0.05, rel=2e-3)
    assert reread(found).verify()
    path = tmp_path / "form.json"
    path.write_text(found.to_json(), encoding="utf-8")
    assert tool.main([str(path)]) == 0
    for name, factor in {
        "affine.proof.ratios.form.torque": 1.1,
        "affine.proof.ratios.form.energy": 3.0,
        "affine.proof.ratios.form.power": 1.3,
        "affine.proof.ratios.form.position": 0.8,
        "affine.proof.ratios.form.velocity": 0.8,
        "affine.proof.ratios.form.split": -1.0,
        "affine.proof.matrices.P0": -1.0,
        "points.stiffest_moving.stiffness": 30.0,
        "points.max_ratio.inertia": 0.5,
    }.items():
        forged = scaled(found, name, factor)
        assert not forged.verify(), name
        path.write_text(forged.to_json(), encoding="utf-8")
        assert tool.main([str(path)]) == 1, name
    assert not replaced(found, "affine.proof.ratios.form", None).verify()
    programs = []
    start = found.evidence.affine.proof
    again = strengthen_robot(
        ball, law, plants, WORKSPACE, samples=30, on_program=lambda: programs.append(1), start=start
    )
    assert again.certified
    assert again.verify()
    assert not programs


@pytest.mark.slow
def test_no_motion_of_the_robot_breaks_the_form_or_the_loop(verdicts):
    _, found, law, plants = verdicts
    form, rng = found.evidence.affine.proof.ratios.form, np.random.default_rng(8)
    points = [
        OperatingPoint(plant, *rng.uniform(-1, 1, (3, 2)) * [[np.pi], [2.0], [8.0]])
        for plant in plants
        for _ in range(400)
    ]
    samples = uncertainty_samples(law.M, points)
    assert samples.friction is not None
    for share in (0.0, 0.4, 1.0):
        rubbed = replace(samples, damping=samples.damping + share * samples.friction)
        assert form.values(rubbed).max() < 1 / 1.05
    channel = decoupled_channels(law)[0]
    attacks = MotionAttacker(channel, law.M, plants, WORKSPACE).attack(200)
    assert attacks.broken == 0


@pytest.mark.slow
def test_it_is_proven_for_every_posture(verdicts, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _, found, law, plants = verdicts
    proven = prove_robot(found, law, plants, WORKSPACE, time_limit=60.0, progress=False)
    assert proven.complete
    assert proven.certificate.verdict_in_words == "certified for every posture"
    assert any("α0 = " in str(part) for part in proven.parts)
