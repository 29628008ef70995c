"""The demo: a law without a model beside one with M̂(q), each with its verdict."""

import numpy as np

from tarc.cli.tables.run import print_runs, run_summary
from tarc.laws.nominal_inertia import NominalInertia
from tarc.scenario.model import Scenario


def test_the_friction_of_the_model_is_a_third_wrong_and_it_does_not_know_the_load():
    setup = Scenario.load("ur5e_model").build()
    known = setup.laws["with a model"].inertia
    assert isinstance(known, NominalInertia)
    for name in ("coulomb", "viscous"):
        np.testing.assert_allclose(known.robot.parameters[name], 0.7 * np.asarray(setup.plant.parameters[name]))
    assert not np.any(known.robot.parameters["payload"])
    assert not isinstance(setup.laws["without a model"].inertia, NominalInertia)


def test_verdicts_are_in_the_table_and_the_summary(capsys):
    scenario = Scenario.load("ur5e_model", ["duration=0.3", "metrics_start=0", "disturbance=[]"])
    runs = scenario.run(progress=False)
    verdicts = dict(zip(runs, ("inconclusive", "certified"), strict=True))
    summary = run_summary(scenario, runs, [], verdicts)
    assert {name: run["verdict"] for name, run in summary["runs"].items()} == verdicts
    assert "verdict" not in run_summary(scenario, runs, [])["runs"]["with a model"]
    print_runs(scenario, runs, [], verdicts)
    printed = capsys.readouterr().out
    assert "on the robot" in printed
    assert "certified" in printed
