"""The soundness benchmark in small: no certificate of random designs is contradicted by roots or by simulation."""

import numpy as np
import pytest

from reference.adversaries import AdversarialLoops, Adversary
from reference.constant_loop import log_growth_after_kick, loop_polynomials, peak_gain, spectral_radius
from reference.law_parameters import LawParameters, draw_parameters
from reference.law_recurrence import recurrence
from reference.soundness_checks import check_ratio, tally_certificates
from reference.soundness_tally import Tally
from reference.uncertain_case import UncertainCase, growth_per_period
from tarc.analysis import stable_interval
from tarc.analysis.linearise import decoupled_channels


@pytest.fixture(scope="module")
def tallies():
    return tally_certificates(160, 12, steps=1500)


@pytest.mark.slow
def test_nothing_contradicts_a_certificate(tallies):
    assert {name: tally.violations for name, tally in tallies.items() if tally.violations} == {}


@pytest.mark.slow
def test_each_verdict_occurs(tallies):
    for name in ("constant_ratio", "constant_ratio, a range", "sector"):
        assert min(tallies[name].certified, tallies[name].refuted) > 0
    assert min(tallies["varying_ratio"].certified, tallies["varying_ratio"].inconclusive) > 0
    assert tallies["constant_ratio"].inconclusive > 0
    assert tallies["sector"].inconclusive > 0
    # most of it must be decided by something, else the count of violations says nothing
    for tally in tallies.values():
        assert tally.undecided < 0.1 * tally.designs


@pytest.mark.parametrize("seed", range(30))
def test_recurrences_by_hand_are_the_laws(seed):
    """The benchmark's own loops against the code of the laws, linearised: with every delay, damping and estimator."""
    rng = np.random.default_rng(seed)
    design = draw_parameters(rng)
    ratio = float(np.exp(rng.uniform(np.log(0.02), np.log(2))))
    (channel,) = decoupled_channels(design.law, design.computation_delay)
    theirs = np.max(np.abs(np.linalg.eigvals(channel.state_matrix(ratio))))
    # poles near one and near zero come in clusters, whose rounding is the root of the machine's
    assert spectral_radius(loop_polynomials(recurrence(design), ratio).closed) == pytest.approx(theirs, abs=2e-5)


def test_a_false_certificate_would_be_found(monkeypatch):
    """The benchmark itself: given that everything is certified, it disagrees."""
    from reference import soundness_checks

    class Liar:
        verdict, certified, witness, numbers = "certified", True, None, {}

    monkeypatch.setattr(soundness_checks, "certify_constant_ratio", lambda *_, **__: Liar)
    rng, tally = np.random.default_rng(0), Tally()
    for _ in range(40):
        check_ratio(draw_parameters(rng), rng, tally)
    assert len(tally.violations) > 5


@pytest.mark.parametrize("computation", [0, 2])
def test_the_fleet_grows_as_the_multiplier_says(computation):
    design = LawParameters(synchronised=True, computation_delay=computation)
    law = recurrence(design)
    known = loop_polynomials(law, 1.0)
    gain, rate = peak_gain(known.a_to_v, known.closed)
    cases = [UncertainCase(law, 1.0, share / gain) for share in (0.9, 1.1)]
    growth = AdversarialLoops(cases, [Adversary("rotate at the peak")]).run(6000)[0]
    for case, log in zip(cases, growth, strict=True):
        size = growth_per_period(case, 0.0, np.array([rate]))[0]
        assert (size > 1) == (case.radius * gain > 1)
        assert log == pytest.approx(3000 * np.log(size), rel=0.05, abs=0.5)


def test_trend_of_known_loops():
    design = LawParameters()
    low, high = stable_interval(design.law)
    for ratio, sign in ((low * 1.05, -1), (low * 0.95, 1), (high * 0.98, -1), (high * 1.02, 1)):
        closed = loop_polynomials(recurrence(design), ratio).closed
        assert np.sign(log_growth_after_kick(closed, spectral_radius(closed))) == sign
    assert np.isnan(log_growth_after_kick(np.array([1.0, -1.0]), 1.0))
