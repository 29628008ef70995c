"""`tarc tune`: search the gains of laws."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tarc.cli.options import Jobs, names_of, numbers_of
from tarc.core.files import writing

if TYPE_CHECKING:
    from tarc.scenario.model import Scenario
    from tarc.study import SearchSpace

Scenarios = Annotated[list[str], typer.Argument(help="Training scenarios: YAML files or names of shipped ones.")]
Laws = Annotated[
    str,
    typer.Option(
        metavar="A,B",
        help="Names of laws with commas between, or all. Default: all, or the one of --law. Those ending in -model "
        "have M̂(q) of the scenario's robot.",
    ),
]
OwnLaw = Annotated[
    str,
    typer.Option(
        "--law",
        metavar="FILE.py:CLASS",
        help="A law from your own file. Inertia, natural frequency and window are searched in the common ranges.",
    ),
]
Range = Annotated[
    list[str] | None,
    typer.Option(
        "--range", metavar="KEY=LOW,HIGH", help="Range of a further gain of the law of --law. May be repeated."
    ),
]
Trials = Annotated[int, typer.Option(help="Number of sets of gains to try per law.")]
Budget = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS",
        help="Largest torque variation \\[N m/s or N/s], one number or one per scenario. Default: what the motion "
        "needs, and what the encoders' noise makes in a PD loop; no law of the scenario enters.",
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the search.")]
GainsFile = Annotated[Path, typer.Option("--out", "-o", help="The file to write.")]


def tune(
    scenarios: Scenarios,
    laws: Laws = "",
    law: OwnLaw = "",
    range_: Range = None,
    trials: Trials = 60,
    budget: Budget = "",
    seed: Seed = 0,
    jobs: Jobs = None,
    out: GainsFile = Path("gains.yaml"),
) -> None:
    """Search the gains of laws for the least RMS error under a limit on torque variation, the same for all laws.

    It prints the limits, and the score of each law, the mean log RMS error.
    Beside it are error and torque variation over those of the best linear
    controller for the same encoder noise and inertia.
    It names the scenarios in which a law is unstable at rest, and writes
    the gains as YAML.

    Example: tarc tune train_two_link --laws tdc,tarc --trials 30

    Example: tarc tune my_robot.yaml --law my_law.py:MyLaw --range max_push=0.1,100

    The shipped gains were tuned on train_two_link, train_ur5e and train_masses.
    """
    from tarc.scenario.model import Scenario
    from tarc.scenario.yaml_text import write_yaml
    from tarc.study import default_search_spaces, tune_all
    from tarc.study.gains_file import relative_laws
    from tarc.study.tuning import unstable_scenarios

    own = own_space(law, range_ or [])
    everything = list(default_search_spaces())
    names = everything if laws.strip() == "all" or not (laws.strip() or own) else names_of(laws)
    names += list(own)
    training = [Scenario.load(name) for name in scenarios]
    limits = limits_of(budget, training)
    tuned = tune_all(names, training, limits, trials=trials, seed=seed, jobs=jobs, spaces=own)
    command = shlex.join(["tarc", *sys.argv[1:]])
    unstable = {name: where for name, (law, _) in tuned.items() if (where := unstable_scenarios(law, training))}
    content = {
        "command": command,
        "limits": {scenario.name: round(limit, 1) for scenario, limit in zip(training, limits, strict=True)},
        "scores": {name: round(score, 4) for name, (_, score) in tuned.items()},
        **({"unstable_at_rest": unstable} if unstable else {}),
        "laws": relative_laws({name: law for name, (law, _) in tuned.items()}, out.parent),
    }
    with writing("--out", out):
        out.write_text(write_yaml(content), encoding="utf-8")
    _print_scores(tuned, unstable, training[0])
    print(f"written: {out}")


def _print_scores(
    tuned: "dict[str, tuple[dict[str, Any], float]]", unstable: dict[str, list[str]], scenario: "Scenario"
) -> None:
    """Print each law's score and its distance from the best linear controller, the best law first."""
    from tarc.study.tuning import optimum_distance

    print(f"{'law':24} {'score':>8}  over the best linear controller in {scenario.name}: error, torque variation")
    for name, (law, score) in sorted(tuned.items(), key=lambda item: (item[0] in unstable, item[1][1])):
        distance = optimum_distance(law, scenario)
        over = "–" if distance is None else f"{distance.ratio:.3g}, {distance.change_ratio:.3g}"
        mark = f"   unstable at rest in {', '.join(unstable[name])}" if name in unstable else ""
        print(f"{name:24} {score:8.3f}  {over:14}{mark}".rstrip())


def own_space(law: str, ranges: list[str]) -> "dict[str, SearchSpace]":
    """Return the search space of the law from a user's own file, by its name; empty for no law.

    Raises
    ------
    InvalidParameter
        For a range that is not two numbers, and ranges without a law.
    """
    from tarc.core.errors import InvalidParameter
    from tarc.scenario.user_law import absolute_kind, is_user_law, law_name
    from tarc.study import user_search_space

    if not law:
        if ranges:
            raise InvalidParameter(f"--range: got {ranges[0]!r} without --law, whose gains it is for")
        return {}
    found = {}
    for text in ranges:
        key, _, ends = text.partition("=")
        numbers = numbers_of("--range", ends)
        if not isinstance(numbers, list) or len(numbers) != 2 or not 0 < numbers[0] < numbers[1]:
            raise InvalidParameter(f"--range: got {text!r}; needs KEY=LOW,HIGH with 0 < LOW < HIGH")
        found[key.strip()] = (numbers[0], numbers[1])
    kind = absolute_kind(law, Path.cwd()) if is_user_law(law) else law
    return {law_name(kind): user_search_space(kind, found)}


def limits_of(budget: str, training: list["Scenario"]) -> list[float]:
    """Return the largest torque variation in each scenario, as given or by the rule, and print it.

    Raises
    ------
    InvalidParameter
        For numbers that are not above zero, or not as many as the scenarios.
    """
    from tarc.core import validation as check
    from tarc.study import torque_variation_budget

    given = numbers_of("--budget", budget)
    if given is not None:
        return check.vector("--budget", given, len(training), 0, strict=True).tolist()
    budgets = [torque_variation_budget(scenario) for scenario in training]
    for scenario, rule in zip(training, budgets, strict=True):
        print(f"{scenario.name}: torque variation at most {rule}")
    return [rule.total for rule in budgets]
