"""Table, file and figure of a certification read it, and compute nothing again."""

from collections import Counter
from dataclasses import replace

import pytest

import tarc
from law_catalogue import make_tdc
from tarc import analysis, certification
from tarc.analysis import Workspace, linearise
from tarc.certificates import robot_points
from tarc.certification import certify_law
from tarc.plotting.certificates import design_figure

ARM = tarc.plants.TwoLinkArm()


@pytest.fixture
def calls(monkeypatch):
    """Count linearisations by law and balls by law, slope and rate."""
    counter = Counter()
    linearise_law, certify_ball = linearise._linearise, certification.certify_varying_ratio

    def counted_linearise(law, gain, joints):
        counter["linearise", repr(law), gain, joints] += 1
        return linearise_law(law, gain, joints)

    def counted_ball(law, *args, **options):
        counter["varying_ratio", repr(law), repr(options)] += 1
        return certify_ball(law, *args, **options)

    monkeypatch.setattr(linearise, "_linearise", counted_linearise)
    monkeypatch.setattr(certification, "certify_varying_ratio", counted_ball)
    return counter


def test_each_ball_is_computed_once_for_table_file_and_figures(calls):
    law = make_tdc(inertia=0.05 * ARM.inertia([0.0, 1.5]))
    certified = certify_law(law, ARM, Workspace.box([-1.0, 0.0], [1.0, 3.0]), samples=50)
    for _ in range(2):
        assert certified.suggestion is certified.suggestion
        design_figure(certified)
    balls = {key: count for key, count in calls.items() if key[0] == "varying_ratio"}
    assert balls
    assert set(balls.values()) == {1}


def test_the_law_is_linearised_once(calls):
    law = make_tdc(inertia=0.05 * ARM.inertia([0.0, 1.5]))
    certified = certify_law(law, ARM, Workspace.box([-1.0, 0.0], [1.0, 3.0]), samples=50)
    design_figure(certified)
    assert analysis.stable_intervals(law, channels=certified.channels)
    assert max(count for key, count in calls.items() if key[0] == "linearise") == 1


def test_laws_share_what_depends_on_the_inertia_and_on_the_loop_alone(monkeypatch):
    counter = Counter()
    search = robot_points.inertia_spread

    def counted(*args, **options):
        counter["spread"] += 1
        return search(*args, **options)

    monkeypatch.setattr(robot_points, "inertia_spread", counted)
    inertia, box = 0.05 * ARM.inertia([0.0, 1.5]), Workspace.box([-1.0, 0.0], [1.0, 3.0])
    first = certify_law(make_tdc(inertia=inertia), ARM, box, samples=50)
    law = replace(first.law, safe_torque="hold")
    second = certify_law(law, ARM, box, samples=50, others=[first])
    other = certify_law(make_tdc(inertia=2 * inertia), ARM, box, samples=50, others=[first, second])
    assert counter["spread"] == 1  # the ratios of a multiple of M̂ are multiples
    for kind in ("lemma1", "theorem1", "theorem2", "nominal"):
        assert second.certificates[kind] is first.certificates[kind]
    assert second.stability_map is first.stability_map
    alone = certify_law(law, ARM, box, samples=50)
    for kind, certificate in alone.certificates.items():
        assert second.certificates[kind].margin == certificate.margin
    assert other.stability_map is not first.stability_map
    assert first.points is not None
    assert other.certificates["lemma1"].evidence.min_ratio == pytest.approx(2 * first.points.spread.min_ratio)
