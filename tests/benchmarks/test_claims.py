"""Studies of the pages that compare laws, and how their tables show an interval."""

import numpy as np
import pytest
from benchmarks.claims import DRAWS, LAWS, gain_draws, paper_study, study_of
from benchmarks.page_values.intervals import shown

from tarc.study import compare_laws


def test_gains_are_drawn_about_their_tuned_values():
    draws = gain_draws([{"natural_frequency": 20.0, "inertia": {"fraction": 0.1}}, {"natural_frequency": 5.0}])
    assert list(draws) == ["law.0.natural_frequency", "law.0.inertia.fraction", "law.1.natural_frequency"]
    assert draws["law.0.inertia.fraction"]["normal"] == pytest.approx(
        {"mean": 0.1, "deviation": 0.005, "low": 0.085, "high": 0.115}
    )


@pytest.mark.parametrize("scenario", ["two_link_payload", "series_elastic"])
def test_studies_have_the_laws_that_can_run(scenario):
    study = study_of(scenario, 8)
    assert set(study.law_names) <= set(LAWS)
    assert study.law_names[0] == "tdc"
    assert ("tdc-model" in study.law_names) == (scenario != "series_elastic")
    assert set(DRAWS[scenario]) <= set(study.distributions)


def test_study_of_the_papers_claims():
    assert "computed torque" in paper_study(8).law_names


def test_cells_show_what_an_interval_decides():
    reference = np.random.default_rng(1).lognormal(size=(100, 1))
    less, more, same = compare_laws(reference * [1.0, 0.5, 2.0, 1.0], ["TDC", "a", "b", "c"])
    assert (shown(less), shown(more), shown(same)) == ("**0.5 to 0.5**", "2 to 2", "*1 to 1*")
