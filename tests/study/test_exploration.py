"""Further runs of a study on a small loop: gradients, the worst case, rare events and Sobol indices."""

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.study import Study, failure_probability, find_worst_case, study_sobol_indices
from tarc.study.loop_gradient import LoopGradient
from tarc.study.objective import StudyObjective

MASS = {
    "name": "mass",
    "scenario": {
        "robot": {"kind": "MassSpringDamper", "masses": [1.0], "springs": [20.0], "dampers": [1.0]},
        "law": [
            {"kind": "TDC", "inertia": 0.06, "natural_frequency": 10.0},
            {"kind": "PID", "label": "PID", "inertia": 0.06, "natural_frequency": 10.0},
        ],
        "estimator": {"kind": "Algebraic", "window": 0.02},
        "reference": {"kind": "Sinusoid", "amplitude": [0.1], "frequency": [2.0]},
        "sensor": {"resolution": 1e-5},
        "duration": 0.6,
        "period": 0.002,
        "metrics_start": 0.1,
        "substeps": 1,
    },
    "draws": {
        "robot.springs.0": {"uniform": [10.0, 40.0]},
        "robot.dampers.0": {"normal": {"mean": 1.0, "deviation": 0.2, "low": 0.0}},
        "reference.amplitude.0": {"uniform": [0.05, 0.15]},
    },
    "runs": 16,
}
WITH_GAIN = {**MASS, "draws": {**MASS["draws"], "law.natural_frequency": {"uniform": [8.0, 12.0]}}}
"""The gain of a law is no input of the loop, which is therefore traced for each run."""

POINT = np.array([0.3, 0.6, 0.4, 0.7])


@pytest.fixture(scope="module")
def objective():
    return StudyObjective(Study.parse(WITH_GAIN))


def test_gradient_through_the_loop_is_that_of_differences(objective):
    """Of parameters, reference and a gain of the law, over the run without quantisation."""
    gradient = LoopGradient(objective)
    step = 1e-4
    rises = [gradient.log_error(POINT + shift) - gradient.log_error(POINT - shift) for shift in step * np.eye(4)]
    assert gradient(POINT) == pytest.approx(np.array(rises) / (2 * step), rel=1e-5, abs=1e-7)


def test_gradient_is_a_direction_for_the_quantised_loop(objective):
    gradient = LoopGradient(objective)(POINT)
    along = 0.05 * gradient / np.linalg.norm(gradient)
    before, after = objective(np.array([POINT - along, POINT + along]))
    assert after > before


def test_runs_that_diverge_are_worse_than_all_others(objective):
    values = np.array([1e-3, 1e-2, np.nan, np.nan, 1e9])
    completed = np.array([True, True, False, False, True])
    severity = objective.severity(values, completed, np.array([0.6, 0.6, 0.5, 0.1, 0.6]))
    assert np.argsort(severity).tolist() == [0, 1, 4, 2, 3]
    assert severity[2] >= objective.divergence_level > severity[4]


@pytest.mark.slow
def test_worst_case_is_replayed_to_the_bit(tmp_path):
    study = Study.parse(MASS)
    result = study.run(tmp_path / "mass.study", progress=False)
    worst = find_worst_case(study, result, generations=2, progress=False)
    assert worst.measures["rms_error"] >= float(result.data["rms_error"].sel(law="TDC").max())
    assert worst.search.value == pytest.approx(np.log(worst.measures["rms_error"]))
    assert float(worst.draws["reference.amplitude.0"]) > 0.145  # the larger the motion, the larger the error
    replay = Study.load(worst.save(tmp_path / "worst.yaml")).run(tmp_path / "worst.study", progress=False)
    assert replay.data["rms_error"].values[0, 0] == worst.measures["rms_error"]
    assert worst.run.metrics(0.1)["rms_error"] == worst.measures["rms_error"]
    assert replay.trace(0).metrics(0.1) == worst.run.metrics(0.1)


@pytest.mark.slow
def test_probability_of_an_error_above_a_limit():
    """Against plain sampling of the same study."""
    study = Study.parse({**MASS, "runs": 400, "sampling": "independent"})
    objective = StudyObjective(study)
    plain = objective(study.points(), study.draw().seeds)
    limit = float(np.quantile(plain, 0.95))
    found = failure_probability(study, limit=float(np.exp(limit)), samples=100, repetitions=4, seed=1, progress=False)
    assert found.probability.low < 0.08
    assert found.probability.high > 0.03
    assert objective(_cube(found.worst_point), np.array([found.worst_seed]))[0] >= limit


@pytest.mark.slow
def test_sobol_indices_of_a_loop():
    found = study_sobol_indices(Study.parse(MASS), 32, seed=1)
    assert found.n_runs == 32 * 5
    largest = max(found.total, key=lambda key: found.total[key].estimate)
    assert largest == "reference.amplitude.0"


def _cube(point):
    from scipy.stats import norm

    return norm.cdf(point)[None]


def test_correlated_draws_have_no_sobol_indices():
    study = Study.parse(
        {**MASS, "correlation": {"keys": ["robot.springs.0", "robot.dampers.0"], "matrix": [[1, 0.5], [0.5, 1]]}}
    )
    with pytest.raises(InvalidParameter, match="independent"):
        study_sobol_indices(study, 16)


def test_unknown_law_and_measure(objective):
    with pytest.raises(InvalidParameter, match="law"):
        StudyObjective(Study.parse(MASS), "TARC")
    with pytest.raises(InvalidParameter, match="rms_eror"):
        StudyObjective(Study.parse(MASS), measure="rms_eror")(POINT[None, :3])
