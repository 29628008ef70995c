"""`tarc tune`: search the gains of laws."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tarc.cli.options import Jobs, names_of, numbers_of
from tarc.core.files import save_text, writing

if TYPE_CHECKING:
    from tarc.scenario.model import Scenario
    from tarc.study import SearchSpace, TuningFront

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
GainsFile = Annotated[Path, typer.Option("--out", "-o", help="The file of gains to write.")]
Objectives = Annotated[
    str,
    typer.Option(
        metavar="A,B",
        help="error: least RMS error under the limit on torque variation. error,variation: the front of both, which "
        "the limit does not bound.",
    ),
]
Margin = Annotated[
    float | None,
    typer.Option(
        help="Least robust margin. Only gains are taken whose loop tolerates all inertia ratios of the robot along the "
        "reference, at any rate of change, with this margin; 0 for just so. It is a certificate, and some laws have "
        "none. Default: no certificate."
    ),
]
Storage = Annotated[
    Path | None,
    typer.Option(
        help="File of the trials. A search that was stopped goes on from it with the same call. Several processes may "
        "share it."
    ),
]
BestFile = Annotated[
    Path | None,
    typer.Option(help="Scenario to write: the first training scenario with the laws found, for tarc run and certify."),
]
FrontFile = Annotated[
    Path | None,
    typer.Option(
        help="File of the front to write, YAML or CSV by its name, and its figure beside it. "
        "Default with two objectives: front.yaml."
    ),
]
Pick = Annotated[
    str,
    typer.Option(
        help="Point of the front for --out and --best: knee, error, variation, or its number, least error first."
    ),
]


def tune(
    scenarios: Scenarios,
    laws: Laws = "",
    law: OwnLaw = "",
    range_: Range = None,
    trials: Trials = 200,
    budget: Budget = "",
    objectives: Objectives = "error",
    margin: Margin = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    storage: Storage = None,
    out: GainsFile = Path("gains.yaml"),
    best: BestFile = None,
    front: FrontFile = None,
    pick: Pick = "knee",
) -> None:
    """Search the gains of laws for the least RMS error under a limit on torque variation, the same for all laws.

    It prints the limits, and the score of each law, the mean log RMS error.
    Beside it are error and torque variation over those of the best linear
    controller for the same encoder noise and inertia.
    It names the scenarios in which a law is unstable at rest, and writes
    the gains as YAML.

    With two objectives it prints and draws the front of least error and
    least torque variation, and writes the gains of one of its points.

    Example: tarc tune train_two_link --laws tdc,tarc --trials 30

    Example: tarc tune my_robot.yaml --law my_law.py:MyLaw --range max_push=0.1,100

    Example: tarc tune arm.yaml --laws tdc --objectives error,variation --margin 0 --best best.yaml

    The shipped gains were tuned on train_two_link, train_ur5e and train_masses.
    """
    from tarc.core.errors import NotConverged
    from tarc.scenario.model import Scenario
    from tarc.study import TuningOptions, default_search_spaces, tune_all, tune_fronts

    both = check_objectives(objectives, pick)
    own = own_space(law, range_ or [])
    everything = list(default_search_spaces())
    names = everything if laws.strip() == "all" or not (laws.strip() or own) else names_of(laws)
    names += list(own)
    training = [Scenario.load(name) for name in scenarios]
    limits = limits_of(budget, training)
    failures: dict[str, str] = {}
    options = TuningOptions(trials=trials, seed=seed, margin=margin, storage=storage, jobs=jobs)
    fronts: dict[str, TuningFront] = {}
    scores: dict[str, float] = {}
    try:
        if both:
            fronts = tune_fronts(names, training, limits, options, spaces=own, failures=failures)
            best_laws = {name: points.pick(pick).law for name, points in fronts.items()}
        else:
            tuned = tune_all(names, training, limits, options, spaces=own, failures=failures)
            best_laws = {name: law for name, (law, _) in tuned.items()}
            scores = {name: score for name, (_, score) in tuned.items()}
    except KeyboardInterrupt:
        hint = f"the same command goes on from {storage}" if storage else "with --storage FILE a search goes on"
        print(f"stopped; {hint}", file=sys.stderr)
        raise typer.Exit(130) from None
    for name, reason in failures.items():
        print(f"{name}: none. {reason}")
    if not best_laws:
        raise NotConverged("tune: no law has gains that meet what is demanded; the reasons stand above")
    _report(best_laws, scores, fronts, training, limits, out)
    if both:
        _write_front(fronts, training, front or Path("front.yaml"), pick)
    if best is not None:
        _write_best(best_laws, training[0], best)


def _report(
    laws: "dict[str, dict[str, Any]]",
    scores: dict[str, float],
    fronts: "dict[str, TuningFront]",
    training: "list[Scenario]",
    limits: list[float],
    out: Path,
) -> None:
    """Write the file of gains, and print each law's score or front."""
    from tarc.scenario.yaml_text import write_yaml
    from tarc.study.gains_file import relative_laws
    from tarc.study.law_scores import unstable_scenarios

    command = shlex.join(["tarc", *sys.argv[1:]])
    unstable = {name: where for name, law in laws.items() if (where := unstable_scenarios(law, training))}
    content = {
        "command": command,
        "limits": {scenario.name: round(limit, 1) for scenario, limit in zip(training, limits, strict=True)},
        **({"scores": {name: round(score, 4) for name, score in scores.items()}} if scores else {}),
        **({"unstable_at_rest": unstable} if unstable else {}),
        "laws": relative_laws(laws, out.parent),
    }
    save_text("--out", out, write_yaml(content))
    if scores:
        _print_scores({name: (laws[name], score) for name, score in scores.items()}, unstable, training[0])
    for name, front in fronts.items():
        _print_front(name, front)
    print(f"written: {out}")


def check_objectives(objectives: str, pick: str) -> bool:
    """Return whether there are two objectives.

    Raises
    ------
    InvalidParameter
        For others than error and variation, and another choice of a point.
    """
    from tarc.core import validation as check
    from tarc.core.errors import InvalidParameter
    from tarc.study.front import PICKS

    given = names_of(objectives)
    if given not in (["error"], ["error", "variation"], ["variation", "error"]):
        raise InvalidParameter(f"--objectives: got {objectives!r}; allowed: error, or error,variation")
    if not pick.isdigit():
        check.one_of("--pick", pick, PICKS)
    return len(given) == 2


def _print_front(name: str, front: "TuningFront") -> None:
    """Print the points of a front."""
    failed = ", ".join(f"{count} {reason}" for reason, count in front.failures.items())
    print(f"{name}: {len(front.points)} points of {front.trials} trials{f', {failed}' if failed else ''}")
    print(f"{'point':>5} {'RMS error':>12} {'torque variation':>18} {'least error there':>18} {'margin':>8}")
    for number, point in enumerate(front.points, 1):
        least = "–" if point.least_error is None else f"{point.least_error:.4g}"
        margin = "–" if point.margin is None else f"{point.margin:.3g}"
        mark = "   knee" if point is front.knee else ""
        print(
            f"{number:5} {point.rms_error:12.4g} {point.torque_variation:18.5g} {least:>18} {margin:>8}{mark}".rstrip()
        )


def _write_front(fronts: "dict[str, TuningFront]", training: "list[Scenario]", file: Path, pick: str) -> None:
    """Write the file of the fronts, and their figure beside it."""
    from tarc.core.units import unit_for_joints
    from tarc.plotting.tuning import front_figure
    from tarc.scenario.yaml_text import write_yaml
    from tarc.study.front import front_csv, front_rows
    from tarc.study.gains_file import relative_laws

    rows = front_rows(fronts)
    for row in rows:
        row["law"] = relative_laws({"law": row["law"]}, file.parent)["law"]
    content = {"command": shlex.join(["tarc", *sys.argv[1:]]), "scenarios": [scenario.name for scenario in training]}
    text = front_csv(fronts) if file.suffix == ".csv" else write_yaml({**content, "points": rows})
    picture = file.with_suffix(".png")
    units = training[0].build_plant().units
    with writing("--front", file):
        file.write_text(text, encoding="utf-8")
        labels = unit_for_joints("rad", units), unit_for_joints("N m/s", units)
        front_figure(fronts, ", ".join(scenario.name for scenario in training), labels, pick).savefig(picture, dpi=110)
    print(f"written: {file}, {picture}")


def _write_best(laws: "dict[str, dict[str, Any]]", scenario: "Scenario", file: Path) -> None:
    """Write the scenario with the laws found."""
    parts = [{**law, "label": name} for name, law in laws.items()]
    scenario.model_copy(update={"law": parts[0] if len(parts) == 1 else parts}).save(file)
    print(f"written: {file}; next: tarc run {file}, tarc certify {file}")


def _print_scores(
    tuned: "dict[str, tuple[dict[str, Any], float]]", unstable: dict[str, list[str]], scenario: "Scenario"
) -> None:
    """Print each law's score and its distance from the best linear controller, the best law first."""
    from tarc.study.law_scores import optimum_distance

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
    free = {}
    for text in ranges:
        key, _, ends = text.partition("=")
        numbers = numbers_of("--range", ends)
        if not isinstance(numbers, list) or len(numbers) != 2 or not 0 < numbers[0] < numbers[1]:
            raise InvalidParameter(f"--range: got {text!r}; needs KEY=LOW,HIGH with 0 < LOW < HIGH")
        free[key.strip()] = (numbers[0], numbers[1])
    kind = absolute_kind(law, Path.cwd()) if is_user_law(law) else law
    return {law_name(kind): user_search_space(kind, free)}


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
