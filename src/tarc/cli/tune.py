"""`tarc tune`: search the gains of laws."""

from pathlib import Path
from typing import Annotated

import typer


def tune(
    scenarios: Annotated[list[str], typer.Argument(help="Training scenarios: YAML files or shipped ones.")],
    laws: Annotated[str, typer.Option(help="Names with commas between, or 'all'.")] = "all",
    trials: Annotated[int, typer.Option(help="Sets of gains to try for each law.")] = 60,
    budget: Annotated[
        float, typer.Option(help="Torque variation allowed, in multiples of that with a perfect sensor.")
    ] = 10.0,
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    jobs: Annotated[int | None, typer.Option(help="Processes; default: one a core.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The file to write.")] = Path("gains.yaml"),
) -> None:
    """Search the gains of laws: one budget, one objective, the least RMS error under a limit on torque variation.

    The laws that tarc compare knows by name were found with:
    tarc tune train_two_link train_ur5e train_masses -o src/tarc/study/gains.yaml
    """
    from tarc.core.files import writing
    from tarc.scenario.model import Scenario
    from tarc.scenario.yaml_text import write_yaml
    from tarc.study import default_search_spaces, torque_variation_limit, tune_all

    names = (
        list(default_search_spaces())
        if laws.strip() == "all"
        else [name.strip() for name in laws.split(",") if name.strip()]
    )
    training = [Scenario.load(name) for name in scenarios]
    limits = [torque_variation_limit(one, budget) for one in training]
    found = tune_all(names, training, limits, trials=trials, seed=seed, jobs=jobs)
    command = f"tarc tune {' '.join(scenarios)} --laws {laws} --trials {trials} --budget {budget:g} --seed {seed}"
    content = {
        "command": command,
        "limits": {one.name: round(limit, 1) for one, limit in zip(training, limits, strict=True)},
        "scores": {name: round(score, 4) for name, (_, score) in found.items()},
        "laws": {name: part for name, (part, _) in found.items()},
    }
    with writing("--out", out):
        out.write_text(write_yaml(content), encoding="utf-8")
    for name, (_, score) in sorted(found.items(), key=lambda item: item[1][1]):
        print(f"{name:20} {score:8.3f}")
    print(f"written: {out}")
