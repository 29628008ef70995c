"""The tool that shares no code with the package: it agrees on certificates of each kind, and finds forged ones out."""

import ast
import copy
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import acb, arb, ctx

import check_certificate as tool
from ball_arithmetic import on_circle, positive, sign, stable
from law_catalogue import make_law, make_tdc
from tarc import NominalInertia, laws, paper, plants
from tarc.analysis import Workspace
from tarc.certificates import (
    certify_affine,
    certify_constant_ratio,
    certify_known_inertia,
    certify_region,
    certify_robot,
    certify_sector,
    certify_varying_ratio,
)
from tarc.core.errors import InvalidParameter
from tarc.paper.kernel import lag_area
from tarc.signals import Quintic
from tarc.stored_certificates import certificate_from_dict

ARM = plants.TwoLinkArm()
PATH = Workspace.box([-0.5, 1.0], [0.5, 2.0])
TOOLS = Path(tool.__file__).parent


def arm_law(share, **options):
    return make_tdc(inertia=share * ARM.inertia([0.0, 1.5]), **options)


def certificates() -> Iterator[tuple[str, Any]]:
    literal, adaptive = make_tdc(), make_law(laws.TARC, 2, max_gain=6.0)
    yield "range", certify_constant_ratio(literal, (0.006, 0.2))
    yield "unstable", certify_constant_ratio(literal, 1.0)
    yield "ball", certify_varying_ratio(literal, 0.08)
    yield "ball with a slope", certify_varying_ratio(literal, 0.08, slope=100.0)
    yield "ball with a rate", certify_varying_ratio(literal, 0.08, rate=20.0, slope=50.0)
    yield "too wide", certify_varying_ratio(literal, ratio_range=(0.006, 0.255))
    yield "sector", certify_sector(adaptive, 0.08, max_gain=0.5)
    yield "unstable slope", certify_sector(literal, 0.08, max_gain=1e5)
    yield "robot", certify_robot(arm_law(0.05), ARM, PATH, samples=50)
    yield "robot at rest", certify_robot(arm_law(0.9), ARM, PATH, samples=50)
    yield "lemma1", paper.check_lemma1(arm_law(0.9), ARM, PATH, samples=50)
    yield "large inertia", paper.check_lemma1(arm_law(5.0), ARM, PATH, samples=50)
    yield "c2", paper.check_condition_c2(adaptive)
    yield "theorem1", paper.check_theorem1(literal)
    yield "large weights", paper.check_theorem1(literal, lyapunov_weight=1.0, D=1.0)
    yield "theorem2", paper.check_theorem2(literal, D=2.0)
    yield "nominal", paper.check_nominal_loop(literal)
    yield "nominal with a decay", paper.check_nominal_loop(literal, decay_rate=1.0)
    known = make_tdc(6, True, 20.0, NominalInertia(ARM, 0.8, gravity=True, coriolis=True))
    slow = Workspace.box([-0.5, 1.0], [0.5, 2.0], speed=1.0)
    yield "known inertia", certify_known_inertia(known, ARM, slow, samples=20, quick=True)
    swing = Quintic(points=[[0.2], [0.5]], times=[0.0, 0.5])
    yield "region", certify_region(make_tdc(2, False), plants.Pendulum(), swing, 0.5, max_error=0.3, samples=10)
    yield "affine", certify_affine(make_tdc(window=5), (0.02, 0.3), 10.0)


@pytest.fixture(scope="module")
def written() -> dict[str, Any]:
    """Certificates of each kind as their files have them, by name."""
    return {name: json.loads(certificate.to_json()) for name, certificate in certificates()}


def forged(content: dict[str, Any], path: str, factor: Any) -> dict[str, Any]:
    """Return a certificate with the entry at a path multiplied by a float, or replaced by anything else."""
    content = copy.deepcopy(content)
    parent: Any = content
    *names, last = [int(name) if name.isdigit() else name for name in path.split(".")]
    for name in names:
        parent = parent[name]
    is_factor = isinstance(factor, float)
    parent[last] = (np.array(parent[last], dtype=float) * factor).tolist() if is_factor else factor
    return content


def test_it_imports_nothing_of_the_package():
    files = [path for path in TOOLS.glob("*.py")]
    own = {path.stem for path in files}
    for path in files:
        text = path.read_text(encoding="utf-8")
        imported = {
            name.split(".")[0]
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""])
        }
        assert imported <= own | set(sys.stdlib_module_names) | {"numpy", "flint"}, path
    assert len((TOOLS / "check_certificate.py").read_text(encoding="utf-8").splitlines()) <= 200


def test_certificates_of_each_kind_hold(written, tmp_path, capsys):
    assert {content["kind"] for content in written.values()} == set(tool.CHECKS)
    (tmp_path / "all.json").write_text(json.dumps(written), encoding="utf-8")
    (tmp_path / "one.json").write_text(json.dumps(written["ball"]), encoding="utf-8")
    assert tool.main([str(tmp_path / "all.json"), str(tmp_path / "one.json")]) == 0
    printed = capsys.readouterr().out
    assert printed.count(": holds") == len(written) + 1
    assert "assumed: Coriolis forces, gravity and friction are only disturbances" in printed
    assert tool.main([]) == 1
    (tmp_path / "one.json").write_text(
        json.dumps(forged(written["ball"], "evidence.ball.radius", 1.1)), encoding="utf-8"
    )
    assert tool.main([str(tmp_path / "one.json")]) == 1
    assert "varying_ratio certified: does not hold" in capsys.readouterr().out


FORGED = [
    ("range", "evidence.max_ratio", 1.4),
    ("range", "evidence.min_ratio", 0.7),
    ("range", "evidence.loops.0.C", 10.0),
    ("range", "evidence.loops.0.B", 0.5),
    ("range", "evidence.loops", []),
    ("range", "evidence.decay_rate", 1.3),
    ("range", "evidence.decay_rate", -1.0),
    ("range", "verdict", "refuted"),
    ("unstable", "verdict", "certified"),
    ("unstable", "witness", None),
    ("unstable", "witness.ratio", 0.1),
    ("unstable", "witness.growth_rate", 1.01),
    ("unstable", "evidence.max_ratio", 0.5),
    ("ball", "evidence.ball.radius", 1.001),
    ("ball", "evidence.ball.centre", 3.0),
    ("ball", "evidence.ball.loop.B_mismatch", 0.5),
    ("ball", "evidence.needed_radius", 1),
    ("ball", "verdict", "refuted"),
    ("ball with a slope", "evidence.slope", 2.0),
    ("ball with a slope", "evidence.ball.loop.half_slope", 0.0),
    ("ball with a slope", "evidence.ball.scale", 100.0),
    ("ball", "evidence.ball.growth", 1.001),
    ("ball", "evidence.ball.growth", 0.99),
    ("ball", "evidence.ball.decay_radius", 1.1),
    ("ball with a rate", "evidence.ball.growth", 1.002),
    ("ball with a rate", "evidence.ball.radius", 1.02),
    ("ball with a rate", "evidence.ball.max_change", None),
    ("ball with a rate", "evidence.ball.max_change", 3.0),
    ("ball with a rate", "evidence.ball.multiplier.coefficients", -1.0),
    ("ball with a rate", "evidence.ball.multiplier.slope", -1.0),
    ("too wide", "verdict", "certified"),
    ("sector", "evidence.max_slope", 100.0),
    ("sector", "evidence.gain_is_bounded", False),
    ("sector", "evidence.decay_rate", 3.0),
    ("unstable slope", "witness.slope", 1e-6),
    ("robot", "evidence.nominal_inertia", 5.0),
    ("robot", "evidence.points.min_ratio.inertia", 20.0),
    ("robot", "evidence.points.max_ratio.inertia", 0.1),
    ("robot", "evidence.points.stiffest.stiffness", 1e3),
    ("robot", "evidence.robust_term_is_bounded", False),
    ("robot", "evidence.ball", None),
    ("robot", "evidence.period", 2.0),
    ("robot", "evidence.ball.growth", 1.01),
    ("robot", "evidence.ball.decay_radius", 0.9),
    ("robot at rest", "witness.growth_rate", 1.01),
    ("robot at rest", "witness.posture", [0.0, 0.0]),
    ("lemma1", "evidence.nominal_inertia", 5.0),
    ("large inertia", "witness.norm", 1.01),
    ("large inertia", "witness.posture", 0.9),
    ("c2", "evidence.P", -1.0),
    ("c2", "evidence.A", -1.0),
    ("c2", "evidence.shrinking.error", -1.0),
    ("theorem1", "evidence.condition.delay", 100.0),
    ("theorem1", "evidence.parts.0.P", 100.0),
    ("theorem1", "evidence.parts", []),
    ("large weights", "witness.e", 0.0),
    ("theorem2", "witness.e", 0.0),
    ("theorem2", "evidence.part.D", -1.0),
    ("theorem2", "verdict", "certified"),
    ("nominal", "evidence.gamma", 0.9),
    ("nominal", "evidence.mean_square_gain", 0.9),
    ("nominal", "evidence.loop.window", 20.0),
    ("nominal", "evidence.parts.0.R2", 0.1),
    ("nominal with a decay", "evidence.peak_gain", 0.9),
    ("nominal with a decay", "evidence.loop.decay_rate", 20.0),
    ("known inertia", "evidence.radius", 10.0),
    ("known inertia", "evidence.decay_growth", 1.01),
    ("known inertia", "evidence.decay_radius", 0.9),
    ("known inertia", "evidence.centre", 3.0),
    ("known inertia", "evidence.max_ratio", 0.9),
    ("known inertia", "evidence.min_ratio", 1.1),
    ("known inertia", "evidence.rate_point.velocity_limits", 1e3),
    ("known inertia", "evidence.points.0.nominal", 5.0),
    ("known inertia", "evidence.loop.C", 10.0),
    ("known inertia", "evidence.robust_term_is_bounded", False),
    ("affine", "evidence.max_ratio", 1.1),
    ("affine", "evidence.rate", 1.5),
    ("affine", "evidence.slope", 10),
    ("affine", "evidence.proof.ratios.relative_rate", 0.5),
    ("affine", "evidence.proof.growth", 1.01),
    ("affine", "evidence.proof.matrices.P1", 1.5),
    ("affine", "evidence.proof.matrices.S", 0.1),
    ("affine", "evidence.proof.loop.storage", -1.0),
    ("affine", "evidence.proof.loop.C", 1.1),
    ("affine", "evidence.proof.multipliers.error", 0.0),
    ("affine", "evidence.proof", None),
]


def test_forged_ones_are_found_out(written):
    for name, path, factor in FORGED:
        assert tool.decide(forged(written[name], path, factor))[0] != 1, (name, path)


OTHER_LOOPS = [
    ("range", "evidence.period", 1.5),
    ("range", "evidence.loops.0.B", 0.5),
    ("ball", "evidence.period", 1.5),
    ("ball", "evidence.ball.loop.B_mismatch", 0.5),
    ("ball", "evidence.ball.loop.B", 0.5),
    ("ball with a slope", "evidence.period", 0.7),
    ("ball with a rate", "evidence.period", 0.7),
    ("robot", "evidence.period", 0.7),
    ("robot", "evidence.ball.loop.B_mismatch", 0.5),
    ("robot at rest", "evidence.period", 0.7),
    ("known inertia", "evidence.period", 0.7),
    ("known inertia", "evidence.loop.B_mismatch", 0.5),
    ("affine", "evidence.proof.ratios.period", 0.7),
    ("affine", "evidence.proof.loop.full.loop.B_mismatch", 0.5),
]
"""Certificates of another loop than the law's: with another period, or another effect of a torque."""


@pytest.mark.parametrize(("name", "path", "factor"), OTHER_LOOPS)
def test_loops_of_another_period_are_found_out(written, name, path, factor):
    changed = forged(written[name], path, factor)
    assert certificate_from_dict(written[name]).verify()
    assert not certificate_from_dict(changed).verify()
    assert tool.decide(changed)[0] != 1
    parent: Any = changed
    for key in path.split(".")[:-1]:
        parent = parent[int(key) if key.isdigit() else key]
    if "A" in parent:  # a torque that moves a state of the controller
        changed = forged(written[name], path.rsplit(".", 1)[0] + ".B", float(1))
        parent = changed
        for key in path.split(".")[:-1]:
            parent = parent[int(key) if key.isdigit() else key]
        parent["B"][-1][0] = 1e-6
        assert not certificate_from_dict(changed).verify()
        assert tool.decide(changed)[0] != 1


def numbers(content: Any, path: str) -> Iterator[str]:
    """Yield the paths of all numbers and arrays."""
    if isinstance(content, dict) or (isinstance(content, list) and content and isinstance(content[0], dict)):
        entries = content.items() if isinstance(content, dict) else enumerate(content)
        for name, entry in entries:
            yield from numbers(entry, f"{path}.{name}")
    elif not (content is None or isinstance(content, bool | str)):
        yield path


TRUE_FOR_THE_TOOL = "min_ratio", "multiplier.stiffness", "max_slope", "error_gain"
"""Entries whose change leaves what the tool tests true, although the package refuses it."""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of the package, for forged numbers
def test_it_accepts_no_forged_one_that_the_package_refuses(written):
    for name, content in written.items():
        for path in numbers(content["evidence"], "evidence"):
            for factor in (0.7, 1.4):
                changed = forged(content, path, factor)
                if content["verdict"] == "inconclusive" or tool.decide(changed)[0] != 1:
                    continue
                try:
                    verified = certificate_from_dict(changed).verify()
                except InvalidParameter:  # an integer became a float
                    continue
                assert verified or any(entry in path for entry in TRUE_FOR_THE_TOOL), (name, path, factor)


# The arithmetic against truth


@pytest.fixture
def _precise():
    with ctx.workprec(256):
        yield


@pytest.mark.usefixtures("_precise")
def test_signs_and_stability():
    def balls(x):
        return np.vectorize(arb, otypes=[object])(np.array(x, dtype=float))

    assert [sign(balls(form)) for form in ([[2, 1], [1, 1]], [[1, 2], [2, 1]], [[1, 1], [1, 1]])] == [1, -1, 0]
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = rng.normal(size=(5, 5))
        for share, answer in ((1 - 1e-9, 1), (1 + 1e-9, -1)):
            assert stable(balls(share / np.abs(np.linalg.eigvals(A)).max() * A)) == answer
    # (t − ½)² + c in Bernstein's basis
    assert [positive([arb(1) / 4 + c, -arb(1) / 4 + c, arb(1) / 4 + c]) for c in (1e-9, -1e-9)] == [1, -1]


@pytest.mark.usefixtures("_precise")
def test_the_circle_against_a_peak_gain_by_hand():
    """z/(z − a) has the peak gain 1/(1 − a); with a pole beside it the degree is two more."""
    a = arb(0.75)
    A, B, C, D = (np.array([[x]], dtype=object) for x in (a, arb(1), a, arb(1)))
    for share, answer in ((1 - 1e-12, 1), (1 + 1e-12, -1)):
        for poles in ((), (arb(0.5),)):

            def form(_, G, share=share):
                return np.array([[acb(1)]]) - (arb(share) / 4) ** 2 * np.conj(G.T) @ G

            assert on_circle(A, B, C, D, form, poles) == answer


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_lag_area_against_the_package(degree):
    assert float(tool.lag_area(degree)) == pytest.approx(float(lag_area(degree)), rel=1e-12)
