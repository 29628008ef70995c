"""The region of attraction, attacked: motions of the nonlinear robot from its boundary, at the rates allowed."""

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import check_certificate as tool
from law_catalogue import make_law, make_tdc
from tarc import Feedforward, NominalInertia, laws, simulate
from tarc.analysis.known_tube import KnownTube, roots
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import matrix_roots
from tarc.analysis.tube import feedforward_along, torques_along
from tarc.certificates import certify_region
from tarc.certificates.region import reference_residuals, tracking_loop
from tarc.certificates.region_evidence import RegionProof
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.plants import Pendulum, TwoLinkArm
from tarc.signals import Encoder, Quintic
from tarc.signals.disturbances import Disturbance
from tarc.stored_certificates import certificate_from_json

T, BITS = 1e-3, 17
HALF_STEP = np.pi / 2**BITS
PENDULUM = Pendulum(viscous=0.1)
SWING = Quintic(points=[[0.2], [1.0]], times=[0.0, 1.0])
PENDULUM_LAW = make_tdc(3, False, 20.0, 0.1)
ARM = TwoLinkArm(viscous=0.2)
REACH = Quintic(points=[[0.2, 0.8], [0.8, 1.4], [0.2, 0.8]], times=[0.0, 2.0, 4.0])
ARM_LAW = make_tdc(6, False, 20.0, 0.08 * ARM.inertia([0.0, 1.1]))


KNOWN_LAW = make_tdc(6, False, 20.0, NominalInertia(ARM, 0.08, gravity=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangle(Disturbance):
    """A torque that starts at zero and always changes at the same rate, one way or the other."""

    frequency: float

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        return 2 / np.pi * np.arcsin(np.sin(self.frequency * times))


def triangle(rate: Any, frequency: float) -> Triangle:
    return Triangle(amplitude=np.asarray(rate) * np.pi / 2 / frequency, frequency=frequency)


@pytest.fixture(scope="module")
def swung():
    return certify_region(
        PENDULUM_LAW, PENDULUM, SWING, 1.0, max_error=0.5, measurement_error=HALF_STEP, torque_rate=5.0, samples=30
    )


def run_from(law, plant, reference, duration, offset, disturbance=()):
    start = reference.sample([0.0])[0][:, 0] + offset
    return simulate(
        plant,
        law,
        reference,
        duration,
        sensor=Encoder(bits=BITS),
        initial_position=start,
        initial_torque="rest",
        disturbance=disturbance,
        progress=False,
    )


def errors(run):
    return (run.data["position"] - run.data["reference"]).values


def test_certified_verified_and_checked_by_the_tool(swung, tmp_path):
    assert swung.certified
    assert swung.verify()
    again = certificate_from_json(swung.to_json())
    assert again.verify()
    assert again.explain() == swung.explain()
    evidence = swung.evidence
    assert evidence.tube_errors == pytest.approx(0.5)
    assert 0.4 < evidence.start_errors[0] < 0.5
    assert evidence.final_errors[0] < 0.02
    assert evidence.start_contains(np.array([0.99]) * evidence.start_errors)
    assert not evidence.start_contains(np.array([1.01]) * evidence.start_errors)
    assert [line.get_ydata()[0] for line in swung.plot().axes[0].lines] == pytest.approx(
        [0.5, *evidence.tube_errors, *evidence.start_errors, *evidence.final_errors]
    )
    path = tmp_path / "region.json"
    path.write_text(swung.to_json(), encoding="utf-8")
    assert tool.main([str(path)]) == 0


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("start_error", 1.01),
        ("final_error", 0.9),
        ("max_error", 0.9),
        ("proof.level", 1.5),
        ("proof.decay", 0.9),
        ("proof.tube.error", 0.9),
        ("proof.bounds.change", 1.5),
        ("proof.ratios.stiffness", 30.0),
        ("proof.ratios.max_ratio", 4.0),
        ("proof.matrices.P0", -1.0),
        ("proof.weights.change", 0.2),
        ("proof.rest_stiffness", 3.0),
        ("proof.start_torque", "50"),
    ],
)
def test_forged_ones_are_found_out_twice(swung, tmp_path, name, factor):
    content = json.loads(swung.to_json())
    parent = content["evidence"]
    *names, last = name.split(".")
    for part in names:
        parent = parent[part]
    value = parent[last]
    parent[last] = float(factor) if isinstance(factor, str) else (factor * np.array(value)).tolist()
    path = tmp_path / "forged.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    assert not certificate_from_json(path.read_text(encoding="utf-8")).verify()
    assert tool.main([str(path)]) == 1


def test_pendulum_never_leaves_its_tube(swung):
    for sign in (-1, 1):
        start = 0.999 * sign * swung.evidence.start_errors
        run = run_from(PENDULUM_LAW, PENDULUM, SWING, 1.0, start, triangle(5.0, 20.0 * sign))
        assert np.all(np.abs(errors(run)) <= swung.evidence.tube_errors)
        assert np.all(np.abs(errors(run)[-200:]) <= swung.evidence.final_errors + 0.5 * np.exp(-0.8 * 10))


def wanted_commands(law, plant, reference, times, nominal, disturbance):
    """c* less what the disturbance takes, at each period (n, k); for a constant M̂ it is M̂⁻¹ (τ* − f)."""
    q, v, a = reference.sample(times)
    if law.has_model:
        none = np.zeros(law.n_joints)
        options = {"error": none, "error_rate": none, "noise": none, "samples": 1, "seed": 0}
        tube = KnownTube(law=law, plants=[plant], reference=reference, duration=times[-1], **options)
        wanted = tube.command(plant, times).T
    else:
        torque = torques_along(plant, q, v, a)
        if law.feedforward is not None:
            torque -= feedforward_along(law)[0](q, v, a)
        wanted = np.linalg.solve(nominal, torque.T[:, :, None])[:, :, 0]
    if disturbance is not None:
        acting = disturbance.sample(times, law.n_joints, np.random.default_rng(0))
        wanted = wanted - np.linalg.solve(nominal, acting.T[:, :, None])[:, :, 0]
    return wanted.T


def lyapunov_values(proof: RegionProof, law, plant, reference, run, disturbance=None):
    """V of the whole state along a run, and the largest difference of the law's command from the loop's.

    With a robust term that difference is what the term adds, which must lie in its sector; the rest is returned.
    """
    data, n_steps = run.data, run.data.sizes["time"]
    times = np.arange(n_steps) * law.period
    channel, own = decoupled_channels(law)[0], tracking_loop(law, 0)
    to_states = state_map(own, proof.loop)
    q, v, _ = reference.sample(times)
    position, measured = data["position"].values, data["measured_position"].values
    nominal = np.array([law.inertia.at(x) if law.has_model else law.M for x in measured])
    wanted = wanted_commands(law, plant, reference, times, nominal, disturbance)
    residual = reference_residuals(law, reference, times[-1])
    e, rate, noise = position.T - q, data["velocity"].values.T - v, (measured - position).T
    torque = data["torque"].values
    if law.maps_torque:
        torque = torque - data["model_torque"].values
    command = np.linalg.solve(nominal, torque[:, :, None])[:, :, 0].T
    _, _, window, held = own.starts.T
    first = plant.holding_torque(position[0])
    if law.maps_torque:
        first = first - law.model_at_rest(measured[0], first)[1]
    started = np.linalg.solve(nominal[0], first) - wanted[:, 0]
    x = np.outer(window[2:], e[:, 0] + noise[:, 0]) + np.outer(held[2:], started)
    P0, P1, Q1 = proof.matrices[:3]
    values, difference = [], 0.0
    for k in range(n_steps):
        seen = (e[:, k] + noise[:, k])[None]
        commanded = channel.C @ x + channel.D @ seen + channel.E @ residual[None, :, k]
        robust = (command[:, k] - wanted[:, k] - commanded[0])[None] / channel.E
        slope, root = law.robust_slope_bound / 2, matrix_roots(nominal[k])[0]
        outside = np.linalg.norm((robust + slope * seen) @ root) - slope * np.linalg.norm(seen @ root)
        difference = max(difference, float(outside))
        z = to_states @ np.vstack([e[:, k], rate[:, k] * law.period, x])
        M = plant.inertia(position[k])
        values.append(np.sum((z.T @ P0 @ z) * nominal[k]) + np.sum((z.T @ (P1 + Q1) @ z) * M))
        if k + 1 < n_steps:
            x = channel.F @ x + channel.G @ seen + channel.H @ (residual[None, :, k] + robust)
            x -= np.outer(held[2:], wanted[:, k + 1] - wanted[:, k])
    return np.array(values), difference


def state_map(own, scaled):
    """Return the matrix from the states of the law to those of the proof, by what both reach."""

    def reached(loop):
        columns = [np.hstack([loop.B, loop.noise, loop.residual, loop.change, loop.starts])]
        for _ in range(len(loop.A)):
            columns.append(loop.A @ columns[-1])
        return np.hstack(columns)

    first, second = reached(own), reached(scaled)
    sizes = np.maximum(np.linalg.norm(first, axis=0), 1e-300)
    return np.linalg.lstsq((first / sizes).T, (second / sizes).T, rcond=None)[0].T


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.1, 0.3])
def test_arm_never_leaves_its_tube(size):
    """Errors all over the boundary of the ellipsoid, rates of torque of both signs: V falls as claimed."""
    rate = 5.0
    certificate = certify_region(
        ARM_LAW, ARM, REACH, 4.0, max_error=size, measurement_error=HALF_STEP, torque_rate=rate, samples=200
    )
    assert certificate.certified
    evidence = certificate.evidence
    proof, inverse_root = evidence.proof, matrix_roots(ARM_LAW.M)[1]
    assert proof is not None
    rng = np.random.default_rng(0)
    for i, angle in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False)):
        offset = 0.9999 * evidence.start_error * inverse_root @ [np.cos(angle), np.sin(angle)]
        assert evidence.start_contains(offset)
        attack = triangle(rate * rng.choice([-1.0, 1.0], 2), [3.0, 12.0, 20.0, 40.0][i % 4])
        run = run_from(ARM_LAW, ARM, REACH, 4.0, offset, attack)
        assert np.all(np.abs(errors(run)) <= evidence.tube_errors)
        assert np.all(np.abs(errors(run)[-500:]) <= evidence.final_errors)
        values, difference = lyapunov_values(proof, ARM_LAW, ARM, REACH, run, attack)
        assert difference < 1e-6, "the loop of the proof is that of the law's own code"
        assert values.max() <= proof.level
        assert np.all(values[1:] <= proof.decay * values[:-1] + proof.supply)


@pytest.mark.slow
@pytest.mark.parametrize(("same_window", "synchronised"), [(False, False), (True, False), (True, True)])
def test_feed_forward_makes_the_tube_smaller(same_window, synchronised, tmp_path):
    """By a model that is wrong by a fifth of the masses; V falls as claimed, and the tool decides the same."""
    model = ARM.with_parameters({"masses": 0.8 * np.asarray(ARM.parameters["masses"])})
    law = replace(
        make_tdc(6, synchronised, 20.0, ARM_LAW.M * (4 if synchronised else 1)),
        feedforward=Feedforward(model, same_window=same_window),
    )
    options = {"max_error": 0.1, "measurement_error": HALF_STEP, "samples": 60}
    found = certify_region(law, ARM, REACH, 4.0, torque_rate=2.0, **options)
    assert found.certified
    if not synchronised:
        alone = certify_region(replace(law, feedforward=None), ARM, REACH, 4.0, torque_rate=2.0, **options)
        assert found.evidence.final_error < 0.8 * alone.evidence.final_error
    (tmp_path / "forward.json").write_text(found.to_json(), encoding="utf-8")
    assert tool.main([str(tmp_path / "forward.json")]) == 0
    proof, inverse_root = found.evidence.proof, matrix_roots(law.M)[1]
    assert proof is not None
    for angle in (0.3,):
        offset = 0.9999 * found.evidence.start_error * inverse_root @ [np.cos(angle), np.sin(angle)]
        attack = triangle([2.0, -2.0], 20.0)
        run = run_from(law, ARM, REACH, 4.0, offset, attack)
        assert np.all(np.abs(errors(run)) <= found.evidence.tube_errors)
        assert np.all(np.abs(errors(run)[-500:]) <= found.evidence.final_errors)
        values, difference = lyapunov_values(proof, law, ARM, REACH, run, attack)
        assert difference < 1e-6, "the loop of the proof is that of the law's own code"
        assert values[0] <= proof.level
        assert np.all(values[1:] <= proof.decay * values[:-1] + proof.supply)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flips(Disturbance):
    """A torque of either sign, at random in blocks of periods."""

    block: int

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        signs = rng.choice([-1.0, 1.0], (n_joints, len(times) // self.block + 1))
        return np.repeat(signs, self.block, axis=1)[:, : len(times)]


@pytest.mark.slow
def test_friction_that_flips_at_any_time_stays_within_the_bound():
    found = certify_region(PENDULUM_LAW, PENDULUM, SWING, 1.0, max_error=0.3, friction=20.0, samples=20)
    assert found.certified
    largest = 0.0
    for block in (1, 3, 10, 15, 20, 25, 30, 40, 60):
        run = run_from(PENDULUM_LAW, PENDULUM, SWING, 1.0, np.zeros(1), Flips(amplitude=20.0, block=block))
        largest = max(largest, float(np.abs(errors(run)).max()))
    assert 0.02 * found.evidence.final_errors < largest < found.evidence.final_errors


@pytest.mark.slow
def test_robust_term_of_tarc_is_covered(tmp_path):
    """The adaptive gain rises and falls at will; V falls as claimed, and the tool decides the same."""
    law = laws.TARC(
        inertia=ARM_LAW.M,
        natural_frequency=20.0,
        period=T,
        estimator=ARM_LAW.estimator,
        rise_rate=4000.0,
        fall_rate=2000.0,
        max_gain=5.0,
        boundary_layer=0.02,
        lyapunov_weight=np.array([800.0, 800.0, 1.0, 1.0]),
    )
    assert law.robust_slope_bound == pytest.approx(250.0)
    found = certify_region(
        law, ARM, REACH, 4.0, max_error=0.1, measurement_error=HALF_STEP, torque_rate=5.0, samples=100
    )
    assert found.certified
    (tmp_path / "tarc.json").write_text(found.to_json(), encoding="utf-8")
    assert tool.main([str(tmp_path / "tarc.json")]) == 0
    proof, inverse_root = found.evidence.proof, matrix_roots(law.M)[1]
    assert proof is not None
    for angle in np.linspace(0, 2 * np.pi, 4, endpoint=False):
        offset = 0.9999 * found.evidence.start_error * inverse_root @ [np.cos(angle), np.sin(angle)]
        attack = triangle([5.0, -5.0], 20.0)
        run = run_from(law, ARM, REACH, 4.0, offset, attack)
        assert run.data["gain"].values.max() > 1.0
        assert np.all(np.abs(errors(run)) <= found.evidence.tube_errors)
        assert np.all(np.abs(errors(run)[-500:]) <= found.evidence.final_errors)
        values, outside = lyapunov_values(proof, law, ARM, REACH, run, attack)
        assert outside < 1e-6, "the robust term lies in its sector"
        assert np.all(values[1:] <= proof.decay * values[:-1] + proof.supply)


@pytest.fixture(scope="module")
def known():
    """Certify a law with M̂(q), on the robot of its model."""
    rate = np.array([5.0, 5.0])
    limits = {"measurement_error": HALF_STEP, "torque_rate": rate, "max_torque": triangle(rate, 3.0).amplitude}
    return certify_region(KNOWN_LAW, ARM, REACH, 4.0, max_error=0.1, samples=80, **limits)


@pytest.mark.slow
def test_a_law_with_a_model_never_leaves_its_tube(known, tmp_path):
    """V = Σ xᵀ (P0⊗M̂(q̂) + (P1 + Q1)⊗M(q)) x falls as claimed, M̂ at the measured position; the tool agrees."""
    assert known.certified
    assert known.verify()
    (tmp_path / "known.json").write_text(known.to_json(), encoding="utf-8")
    assert tool.main([str(tmp_path / "known.json")]) == 0
    evidence = known.evidence
    proof, inverse_root = evidence.proof, matrix_roots(evidence.nominal_inertia)[1]
    assert proof is not None
    for i, angle in enumerate(np.linspace(0.3, 2 * np.pi, 3, endpoint=False)):
        offset = 0.9999 * evidence.start_error * inverse_root @ [np.cos(angle), np.sin(angle)]
        assert evidence.start_contains(offset)
        attack = triangle([5.0, -5.0], [3.0, 12.0, 20.0][i])
        run = run_from(KNOWN_LAW, ARM, REACH, 4.0, offset, attack)
        assert np.all(np.abs(errors(run)) <= evidence.tube_errors)
        assert np.all(np.abs(errors(run)[-500:]) <= evidence.final_errors)
        values, difference = lyapunov_values(proof, KNOWN_LAW, ARM, REACH, run, attack)
        assert difference < 1e-6, "the loop of the proof is that of the law's own code"
        assert values.max() <= proof.level
        assert np.all(values[1:] <= proof.decay * values[:-1] + proof.supply)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "factor"), [("ratios.nominal_rate", 20.0), ("matrices.S0", 0.5), ("bounds.torque", 3e3), ("level", 1.5)]
)
def test_forged_ones_with_a_model_are_found_out_twice(known, tmp_path, name, factor):
    content = json.loads(known.to_json())
    *names, last = name.split(".")
    parent = content["evidence"]["proof"]
    for part in names:
        parent = parent[part]
    parent[last] = (factor * np.array(parent[last])).tolist()
    path = tmp_path / "forged.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    assert not certificate_from_json(path.read_text(encoding="utf-8")).verify()
    assert tool.main([str(path)]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("terms", [{}, {"gravity": True, "coriolis": True}])
def test_forces_of_random_states_keep_to_their_bound(terms):
    """M̂(q̂) c* + ĥ(q̂, q̇ᵈ) − M q̈ᵈ − N at random states of the tube, with a load that the model lacks."""
    law = make_tdc(6, False, 20.0, NominalInertia(ARM, 0.08, **terms))
    loaded, size, random = ARM.with_parameters({"payload": 0.3}), np.array([0.05, 0.1]), np.random.default_rng(0)
    tube = KnownTube(
        law=law,
        plants=[loaded],
        reference=REACH,
        duration=4.0,
        error=size,
        error_rate=30 * size,
        noise=np.full(2, HALF_STEP),
        samples=100,
        seed=0,
    )
    found = tube.bounds(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros((2, 4)))
    times = random.uniform(0, 4, 5000)
    q, v, a = REACH.sample(times)
    e, rate = (scale[:, None] * random.uniform(-1, 1, q.shape) for scale in (size, 30 * size))
    measured = q + e + HALF_STEP * random.choice([-1.0, 1.0], q.shape)
    nominal, known = tube.nominal(measured), NominalInertia(ARM, 0.08, **terms).forces(measured, v)
    held = np.einsum("kij,jk->ik", nominal, tube.command(loaded, times)) + known
    force = (
        held
        - torques_along(loaded, q + e, v + rate, 0 * a)
        - np.einsum("kij,jk->ik", loaded.inertia_matrices(q + e), a)
    )
    root, inverse_root = roots(nominal)
    sizes = [np.linalg.norm(np.einsum("kij,jk->ik", root, part), axis=0) for part in (e, rate)]
    acting = np.linalg.norm(np.einsum("kij,jk->ik", inverse_root, force), axis=0)
    for stiffness, lead_time in zip(found.robot.stiffness, found.robot.lead_times, strict=True):
        allowed = stiffness * np.hypot(sizes[0], lead_time * sizes[1]) + found.own_stiffness * found.noise
        assert np.all(acting <= allowed)
        assert np.any(acting > 0.15 * allowed)
    changed = []  # of M and M̂ in a short time, as they move at the speeds of the tube
    step, turned = 1e-5, np.abs(v) + 30 * size[:, None]
    for inertias, noise in ((loaded.inertia_matrices, 0.0), (tube.nominal, 2 * HALF_STEP / T)):
        moved = e + step * (turned + noise) * random.choice([-1.0, 1.0], q.shape)
        first = roots(inertias(q + e))[1]
        changed.append(np.abs(np.log(np.linalg.eigvalsh(first @ inertias(q + moved) @ first))).max() / step)
    limits = found.robot.relative_rate, found.nominal_rate
    assert np.all(0.8 * np.array(limits) < changed)
    assert np.all(changed < (1 + 1e-3) * np.array(limits))


@pytest.mark.slow
def test_too_much_friction_is_left_undecided():
    found = certify_region(PENDULUM_LAW, PENDULUM, SWING, 1.0, max_error=0.02, friction=200.0, samples=20)
    assert found.verdict == "inconclusive"
    assert found.evidence.start_error == 0
    assert certificate_from_json(found.to_json()).verify()


def test_bad_input():
    def certify(law, plant=ARM, reference=REACH, max_error=0.1, friction=0.0):
        return certify_region(law, plant, reference, 1.0, max_error=max_error, friction=friction)

    with pytest.raises(UnsupportedLaw, match="covers tarc.laws.TDC"):
        certify(make_law(laws.IVF))
    with pytest.raises(UnsupportedLaw, match="give max_gain"):
        certify(make_law(laws.TARC))
    with pytest.raises(UnsupportedLaw, match="M̂\\(q\\) with a computation delay"):
        certify_region(KNOWN_LAW, ARM, REACH, 1.0, max_error=0.1, computation_delay=1)
    with pytest.raises(UnsupportedLaw, match="torque limit"):
        certify(replace(ARM_LAW, torque_limit=10.0))
    with pytest.raises(UnsupportedLaw, match="differ between the joints"):
        certify(make_tdc(natural_frequency=[10.0, 20.0], inertia=[0.1, 0.1]))
    with pytest.raises(InvalidParameter, match="2 and 1 joints, the law 2"):
        certify(ARM_LAW, reference=SWING)
    with pytest.raises(InvalidParameter, match="has dry friction of \\[0.5, 0.5\\]"):
        certify(ARM_LAW, TwoLinkArm(coulomb=0.5), friction=0.4)
    with pytest.raises(InvalidParameter, match="max_error"):
        certify(ARM_LAW, max_error=0.0)
