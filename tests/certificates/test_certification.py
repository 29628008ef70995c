"""All certificates at once: from Python, from a scenario, from the command line."""

import json

import numpy as np
import pytest

import tarc
from law_catalogue import make_law, make_tdc
from tampering import reread
from tarc.analysis import Workspace
from tarc.certification import certify_law
from tarc.core.errors import UnsupportedLaw
from tarc.scenario.yaml_text import write_yaml
from tarc.stored_certificates import certificate_from_dict
from tarc_command import run_tarc

ARM = tarc.plants.TwoLinkArm()
BOX = Workspace.box([-0.5, 1.0], [0.5, 2.0])


def adaptive_law(**options):
    return make_law(tarc.laws.TARC, inertia=0.05 * ARM.inertia([0.0, 1.5]), boundary_layer=0.1, **options)


def test_every_certificate_that_applies_verifies_and_survives_json(tmp_path):
    found = certify_law(adaptive_law(max_gain=1.0), ARM, BOX, samples=50).certificates
    assert list(found) == [
        "robot",
        "constant_ratio",
        "sector",
        "varying_ratio",
        "lemma1",
        "c2",
        "theorem1",
        "theorem2",
        "nominal",
    ]
    for kind, one in found.items():
        assert one.kind == kind
        again = reread(one)
        assert again.verdict == one.verdict
        assert again.verify(), kind
        assert one.claim.split()[0] in one.explain()
        one.plot().savefig(tmp_path / f"{kind}.png")
        assert (tmp_path / f"{kind}.png").stat().st_size > 5000


def test_those_that_do_not_apply_are_left_out():
    plain = certify_law(make_tdc(inertia=0.05 * ARM.inertia([0.0, 1.5])), ARM, BOX, samples=50).certificates
    assert not {"sector", "c2"} & set(plain)
    filtered = tarc.estimators.FilteredDifference(cutoff=300.0)
    other = certify_law(
        make_law(tarc.laws.TDC, inertia=[0.05, 0.02], estimator=filtered), ARM, BOX, samples=50
    ).certificates
    assert not {"theorem2", "nominal"} & set(other)
    apart = certify_law(
        make_law(tarc.laws.TDC, inertia=[0.05, 0.02], natural_frequency=[10.0, 20.0]), ARM, BOX, samples=50
    ).certificates
    assert "varying_ratio" not in apart
    assert apart["robot"].verdict in ("inconclusive", "refuted")


def test_a_law_without_time_delay_estimation_gets_what_applies_to_it():
    law = make_law(tarc.laws.PID, inertia=0.5 * ARM.inertia([0.0, 1.5]), integral_gain=1.0)
    steps = []
    found = certify_law(law, ARM, BOX, samples=50, on_certificate=steps.append).certificates
    assert list(found) == steps == ["robot", "constant_ratio", "varying_ratio", "lemma1"]
    assert found["constant_ratio"].certified


def test_the_loop_is_tested_over_the_ratios_that_the_robot_has():
    found = certify_law(adaptive_law(max_gain=1.0), ARM, BOX, samples=50).certificates
    assert found["constant_ratio"].evidence.min_ratio == found["robot"].evidence.min_ratio
    assert found["constant_ratio"].evidence.max_ratio == found["robot"].evidence.max_ratio


@pytest.fixture
def scenario(tmp_path):
    content = {
        "robot": {"kind": "TwoLinkArm"},
        "law": [{"kind": "TDC", "inertia": {"fraction": 0.05}, "natural_frequency": 10.0}],
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.3], "frequency": 2.0, "offset": [0.0, 1.5]},
        "disturbance": [{"kind": "ParameterSchedule", "parameter": "masses", "times": [0.5], "values": [[1.0, 3.0]]}],
        "duration": 1.0,
    }
    (tmp_path / "swing.yaml").write_text(write_yaml(content))
    return tmp_path


def test_command_prints_verdicts_and_writes_certificates(scenario):
    done = run_tarc("certify", "swing.yaml", "--prove", cwd=scenario)
    assert "TDC: certified for every posture inertia ratios from" in " ".join(done.stdout.split())
    for part in ("certified", "this robot", "Lemma 1", "Theorem 2", "least ratio", "ball arithmetic", "spread"):
        assert part in done.stdout
    stored = json.loads((scenario / "runs/swing/TDC-certificates.json").read_text())
    assert all(certificate_from_dict(one).verify() for one in stored.values())
    assert (scenario / "runs/swing/TDC-design.png").stat().st_size > 20000
    assert (scenario / "runs/swing/TDC-robot.png").is_file()


def test_command_as_json_with_settings(scenario):
    done = run_tarc(
        "certify", "swing.yaml", "--json", "--no-figures", "--set", "law.0.inertia.fraction=0.5", cwd=scenario
    )
    content = json.loads(done.stdout)
    verdict = content["certificates"]["TDC"]["robot"]
    assert verdict["verdict"] == "refuted"
    assert len(verdict["witness"]["posture"]) == 2
    assert content["files"] == ["runs/swing/TDC-certificates.json"]


@pytest.mark.slow
def test_command_tries_an_affine_function_after_the_quick_verdicts(tmp_path):
    (tmp_path / "arm.yaml").write_text(AFFINE_ARM)
    options = ["arm.yaml", "--full-range", "--speed", "2", "--samples", "60", "--no-figures"]
    quick, whole = run_tarc("certify", *options, "--quick", cwd=tmp_path), run_tarc("certify", *options, cwd=tmp_path)
    line = "TDC by a Lyapunov function affine in the inertia: certified on 60 sampled"
    assert line not in " ".join(quick.stdout.split())
    assert line in " ".join(whole.stdout.split())
    stored = json.loads((tmp_path / "runs/arm/TDC-certificates.json").read_text())
    assert certificate_from_dict(stored["robot"]).verify()
    assert stored["robot"]["evidence"]["affine"] is not None


AFFINE_ARM = """
name: arm
robot: {kind: TwoLinkArm}
reference: {kind: Sinusoid, amplitude: [0.3, 0.3], frequency: 2.0}
estimator: {kind: Algebraic, window: 0.006, degree: 2}
law:
  kind: TDC
  inertia: [[1.3448, 0.5043], [0.5043, 0.5043]]
  natural_frequency: 44.0
  synchronised: true
disturbance:
  - {kind: ParameterSchedule, parameter: payload, times: [0.5], values: [2.0]}
duration: 1.0
"""


def test_a_schedule_counts_only_if_it_comes_before_the_end(scenario):
    whole = tarc.Scenario.load(scenario / "swing.yaml").certify(samples=50)["TDC"].verdict
    short = tarc.Scenario.load(scenario / "swing.yaml", ["duration=0.4"]).certify(samples=50)["TDC"].verdict
    assert whole.evidence.min_ratio < 0.8 * short.evidence.min_ratio


def test_full_range_is_wider_than_the_path(scenario):
    described = tarc.Scenario.load(scenario / "swing.yaml")
    path = described.certify(samples=100)["TDC"].verdict.evidence.ratio_spread
    assert described.certify(samples=100, full_range=True)["TDC"].verdict.evidence.ratio_spread > path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("swing.yaml", "--tube", "-1"), "tube: got"),
        (("swing.yaml", "--samples", "0"), "samples: got 0"),
        (("nowhere.yaml",), "not found"),
    ],
)
def test_bad_input(scenario, arguments, message):
    done = run_tarc("certify", *arguments, "--no-figures", cwd=scenario, status=2)
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_law_without_an_inertia_is_refused():
    with pytest.raises(UnsupportedLaw, match="needs? a law with an inertia"):
        certify_law("PID", ARM, BOX)  # type: ignore[arg-type]


def swing_scenario(*laws, **changes):
    """Return a scenario of a two-link arm that swings."""
    return tarc.Scenario.parse(
        {
            "robot": {"kind": "TwoLinkArm"},
            "law": list(laws),
            "estimator": {"kind": "Algebraic", "window": 0.01, "degree": 2},
            "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.2], "frequency": [1.0, 2.0]},
            "duration": 7.0,
            **changes,
        }
    )


CALM = {"kind": "TDC", "inertia": {"fraction": 0.05}, "natural_frequency": 10.0}
WITH_MODEL = {"kind": "ComputedTorque", "model": "robot", "natural_frequency": 10.0}


def test_a_law_without_certificates_is_skipped_and_named():
    found = swing_scenario(WITH_MODEL, CALM).certify(samples=30)
    assert list(found) == ["TDC"]
    assert "ComputedTorque" in found.skipped["ComputedTorque"]
    with pytest.raises(UnsupportedLaw, match="ComputedTorque"):
        swing_scenario(WITH_MODEL).certify(samples=30)
    with pytest.raises(UnsupportedLaw, match="no certificate applies to any"):
        swing_scenario(WITH_MODEL, {**WITH_MODEL, "label": "again"}).certify(samples=30)


def test_the_speeds_are_those_of_the_reference():
    point = swing_scenario(CALM).certify(samples=30)["TDC"].verdict.evidence.max_rate_point
    assert point is not None
    assert point.velocity_limits == pytest.approx([1.2 * 0.3, 1.2 * 0.4], rel=1e-6)
    assert swing_scenario(CALM).certify(samples=30, speed=np.inf)["TDC"].verdict.evidence.rate is None
    assert swing_scenario(CALM).certify(samples=30, full_range=True)["TDC"].verdict.evidence.rate is None
