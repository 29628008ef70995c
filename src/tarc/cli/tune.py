"""`tarc tune`: search the gains of laws."""

from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Jobs, names_of
from tarc.core.files import writing

Scenarios = Annotated[list[str], typer.Argument(help="Training scenarios: YAML files or names of shipped ones.")]
Laws = Annotated[str, typer.Option(metavar="A,B", help="Names of laws with commas between, or all.")]
Trials = Annotated[int, typer.Option(help="Number of sets of gains to try per law.")]
Budget = Annotated[
    float,
    typer.Option(help="Largest torque variation, over that of the scenario's own law with a perfect sensor."),
]
Seed = Annotated[int, typer.Option(help="Seed of the search.")]
GainsFile = Annotated[Path, typer.Option("--out", "-o", help="The file to write.")]


def tune(
    scenarios: Scenarios,
    laws: Laws = "all",
    trials: Trials = 60,
    budget: Budget = 10.0,
    seed: Seed = 0,
    jobs: Jobs = None,
    out: GainsFile = Path("gains.yaml"),
) -> None:
    """Search the gains of laws for the least RMS error under a limit on torque variation, the same for all laws.

    It prints the score of each law, the mean log RMS error, and writes the gains as YAML.

    Example: tarc tune train_two_link --laws tdc,tarc --trials 30

    The shipped gains come from: tarc tune train_two_link train_ur5e train_masses
    """
    from tarc.scenario.model import Scenario
    from tarc.scenario.yaml_text import write_yaml
    from tarc.study import default_search_spaces, torque_variation_limit, tune_all

    names = list(default_search_spaces()) if laws.strip() == "all" else names_of(laws)
    training = [Scenario.load(name) for name in scenarios]
    limits = [torque_variation_limit(scenario, budget) for scenario in training]
    tuned = tune_all(names, training, limits, trials=trials, seed=seed, jobs=jobs)
    command = f"tarc tune {' '.join(scenarios)} --laws {laws} --trials {trials} --budget {budget:g} --seed {seed}"
    content = {
        "command": command,
        "limits": {scenario.name: round(limit, 1) for scenario, limit in zip(training, limits, strict=True)},
        "scores": {name: round(score, 4) for name, (_, score) in tuned.items()},
        "laws": {name: law for name, (law, _) in tuned.items()},
    }
    with writing("--out", out):
        out.write_text(write_yaml(content), encoding="utf-8")
    for name, (_, score) in sorted(tuned.items(), key=lambda item: item[1][1]):
        print(f"{name:20} {score:8.3f}")
    print(f"written: {out}")
