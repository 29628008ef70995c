"""The command line: parse, call the library, print."""

import json
import os
import re
import shlex
import sys
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    name="tarc",
    help="Robot tracking from position measurements alone: time-delayed adaptive robust control.\n\n"
    "Start with [bold]tarc demo[/bold], look around with [bold]tarc show[/bold], then write a scenario of your own "
    "and [bold]tarc run[/bold] it.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
)

Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a key of the scenario, e.g. law.natural_frequency=15. Repeatable."
    ),
]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results; default runs/NAME.")]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON instead of a table.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")]


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="A YAML file, or the name of a shipped scenario.")],
    set_: Set = None,
    out: Out = None,
    native: Annotated[bool, typer.Option("--native", help="Compile the loop first; needs a C compiler.")] = False,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Simulate a scenario: metrics, trajectories as netCDF, figures.

    Example: tarc run ur5e --set law.natural_frequency=15 --set duration=5
    """
    from tarc.scenario.model import Scenario

    _run(Scenario.load(scenario, [*(set_ or []), *(["native=true"] if native else [])]), out, as_json, figures)


@app.command()
def demo(out: Out = None, as_json: Json = False, figures: Figures = True) -> None:
    """A UR5e follows a trajectory with encoders alone and picks up 5 kg half-way: TARC and TDC side by side."""
    from tarc.scenario.model import Scenario

    _run(Scenario.load("ur5e"), out or Path("runs/demo"), as_json, figures)


@app.command()
def certify(
    scenario: Annotated[str, typer.Argument(help="A YAML file, or the name of a shipped scenario.")],
    set_: Set = None,
    out: Out = None,
    tube: Annotated[float, typer.Option(help="How far a joint may be from its reference \\[rad or m].")] = 0.01,
    full_range: Annotated[
        bool, typer.Option("--full-range", help="All that the joints reach, instead of the reference.")
    ] = False,
    speed: Annotated[
        str,
        typer.Option(metavar="NUMBERS", help="Greatest speed of the joints, rad/s or m/s; default: any speed."),
    ] = "",
    acceleration: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="And their greatest acceleration, rad/s² or m/s²; default: four times the speed, a second.",
        ),
    ] = "",
    samples: Annotated[int, typer.Option(help="Postures to sample, before a local search.")] = 2000,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Certify a scenario's laws on its robot: is the design stable, how far from the edge, and in which posture.

    Certified, refuted or inconclusive, each with its margin. The first row is the verdict for the robot, the next are
    what it rests on, the last what the paper's own conditions say.

    Example: tarc certify ur5e --set law.synchronised=true --set law.inertia.fraction=0.5
    """
    from tarc.scenario.model import Scenario

    described = Scenario.load(scenario, set_ or [])
    folder = _folder(out or Path("runs") / _stem(described.name))
    swift, steep = _numbers("--speed", speed), _numbers("--acceleration", acceleration)
    found = described.certify(tube=tube, full_range=full_range, speed=swift, acceleration=steep, samples=samples)
    files = save_certificates(described, found, folder, figures)
    from tarc.cli import tables

    if as_json:
        print(json.dumps(tables.certificate_summary(described, found, files), indent=2, allow_nan=False))
    else:
        tables.print_certificates(described, found, files)


ROBOT, ASKED = "The robot", "What is asked for"


@app.command()
def design(
    ctx: typer.Context,
    robot: Annotated[str, typer.Argument(help="An MJCF or URDF file, or the name of a shipped robot.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="The scenario to write; certificates and figures go beside it."),
    ] = Path("design.yaml"),
    joints: Annotated[
        str, typer.Option(metavar="A,B", help="Joints to drive; default all. Others are locked.", rich_help_panel=ROBOT)
    ] = "",
    armature: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="Rotor inertia at the joints, kg m²: of the rotor, times the gear ratio squared. One number, or one a "
            "joint with commas between. Most files have none, and without it light links make M(q) vary more than any "
            "loop bears.",
            rich_help_panel=ROBOT,
        ),
    ] = "",
    viscous: Annotated[
        str, typer.Option(metavar="NUMBERS", help="Viscous friction, N m s/rad.", rich_help_panel=ROBOT)
    ] = "",
    coulomb: Annotated[str, typer.Option(metavar="NUMBERS", help="Coulomb friction, N m.", rich_help_panel=ROBOT)] = "",
    torque_limit: Annotated[
        str,
        typer.Option(metavar="NUMBERS", help="In place of those in the file, N m or N.", rich_help_panel=ROBOT),
    ] = "",
    tool: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Link or site that carries the payload; default a site named tool, else the last link.",
            rich_help_panel=ROBOT,
        ),
    ] = "",
    payload: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Least and greatest load at the tool, kg.", rich_help_panel=ASKED),
    ] = (0.0, 0.0),
    encoder_bits: Annotated[
        int, typer.Option(help="Resolution of the encoders, bits a turn.", rich_help_panel=ASKED)
    ] = 17,
    rate: Annotated[float, typer.Option(help="Control periods a second, Hz.", rich_help_panel=ASKED)] = 1000.0,
    computation_delay: Annotated[
        int, typer.Option(help="Periods between a measurement and its torque.", rich_help_panel=ASKED)
    ] = 0,
    reach: Annotated[
        float | None,
        typer.Option(
            help="Certify only for postures within ± so much of the home posture, rad (m for a slide), instead of all "
            "that the joints reach.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    speed: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="Greatest speed of the joints, rad/s or m/s: the slower the robot, the better the gains that can be "
            "certified. Default: the velocity limits in the file, where it has them; inf for any speed.",
            rich_help_panel=ASKED,
        ),
    ] = "",
    acceleration: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="And their greatest acceleration, rad/s² or m/s². Default: four times the speed, a second.",
            rich_help_panel=ASKED,
        ),
    ] = "",
    noise: Annotated[
        float | None,
        typer.Option(
            help="Torque noise allowed: its RMS as a share of the torque limit, 0.02 for 2 %. Default: 0.01, or as "
            "little as can be certified, or as a given natural frequency allows.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    natural_frequency: Annotated[
        float | None, typer.Option(help="In rad/s; default: as high as the noise allows.", rich_help_panel=ASKED)
    ] = None,
    damping: Annotated[float, typer.Option(help="Damping ratio of the error.", rich_help_panel=ASKED)] = 1.0,
    law: Annotated[
        str, typer.Option(metavar="tarc|tdc", help="With the adaptive gain or without.", rich_help_panel=ASKED)
    ] = "tarc",
    diagonal: Annotated[
        bool, typer.Option("--diagonal", help="Only a diagonal inertia M̂.", rich_help_panel=ASKED)
    ] = False,
    limits: Annotated[
        bool,
        typer.Option(
            "--limits",
            help="Say also how far the design can be pushed: payload, bits, rate, delay; takes minutes.",
        ),
    ] = False,
    samples: Annotated[int, typer.Option(help="Postures to sample, before a local search.")] = 500,
    seed: Annotated[int, typer.Option(help="Of the samples.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON instead of a table.")] = False,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """From a robot's file and its encoders to certified gains: a scenario ready to run, each choice with its reason.

    The inertia M̂ is shaped so that M(q)⁻¹M̂ varies least over all postures and
    payloads. Window, natural frequency and the rest are chosen so that the loop bears
    this, with as little error as the torque noise allowed permits. What cannot
    be certified is refused, with what to relax and by how much. Takes a minute
    or so.

    Example: tarc design ur5e --payload 0 5 --armature 0.1 -o design.yaml

    Then: tarc run design.yaml; tarc certify design.yaml --full-range
    """
    from tarc.cli import tables
    from tarc.core import validation as check
    from tarc.core.errors import TarcError
    from tarc.design import DesignRequirements, design_controller, stress_test
    from tarc.design.writer import check_writable
    from tarc.plants import MujocoPlant
    from tarc.signals import Encoder

    plant = MujocoPlant.from_file(
        robot,
        joints=[name.strip() for name in joints.split(",") if name.strip()] or None,
        armature=_numbers("--armature", armature),
        viscous=_numbers("--viscous", viscous),
        coulomb=_numbers("--coulomb", coulomb),
        tool=tool or None,
    )
    if noise is not None and not 0 < noise <= 1:
        raise TarcError(f"--noise: got {noise:g}; needs a share of the torque limit, such as 0.02 for 2 %")
    requirements = DesignRequirements(
        period=1 / check.number("--rate", rate, 0, strict=True),
        sensor=Encoder(bits=check.integer("--encoder-bits", encoder_bits, 1, 52)),
        payload=payload,
        joint_range=reach,
        speed=_numbers("--speed", speed),
        acceleration=_numbers("--acceleration", acceleration),
        natural_frequency=natural_frequency,
        damping_ratio=damping,
        noise_budget=noise,
        torque_limits=_numbers("--torque-limit", torque_limit),
        law=check.one_of("--law", law.lower(), ("tarc", "tdc")).upper(),
        diagonal=diagonal,
        computation_delay=computation_delay,
        samples=samples,
        seed=seed,
    )
    file = check_writable(out)
    result = design_controller(plant, requirements)
    drawn = {}
    if figures:
        from rich.console import Console

        from tarc.plotting.design import design_figures

        with Console(stderr=True).status("drawing figures"):
            drawn = design_figures(result)
    files = result.save(file, figures=drawn, command=shlex.join(["tarc", *sys.argv[1:]]))
    if not as_json:
        tables.print_design(result, files)
    found = {}
    if limits:
        found = stress_test(result)
    if as_json:
        print(json.dumps(tables.design_summary(result, files, found), indent=2, allow_nan=False))
    elif found:
        tables.print_limits(found)


def _numbers(name: str, text: str) -> float | list[float] | None:
    """One number, or several with commas between; None for nothing."""
    from tarc.core.errors import TarcError

    try:
        found = [float(one) for one in text.split(",")] if text.strip() else []
    except ValueError:
        raise TarcError(f"{name}: got {text!r}; needs one number, or one a joint with commas between") from None
    return found if len(found) > 1 else found[0] if found else None


@app.command()
def compare(
    scenario: Annotated[str, typer.Argument(help="A YAML file, or the name of a shipped scenario.")],
    laws: Annotated[
        str, typer.Option(help="Names with commas between, or 'all'; default: the laws of the scenario.")
    ] = "",
    set_: Set = None,
    out: Out = None,
    jobs: Annotated[int | None, typer.Option(help="Processes; default: one a core.")] = None,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Run several laws in one scenario, on the same seed: table, trajectories, CSV, LaTeX, figures.

    The names stand for laws whose gains were found by one search with one budget; tarc show --json lists them.

    Example: tarc compare ur5e --laws tarc,tdc,tdc-sync
    """
    from tarc.cli import tables
    from tarc.scenario.model import Scenario
    from tarc.study import compare, tuned_laws

    described = Scenario.load(scenario, set_ or [])
    folder = _folder(out or Path("runs") / f"{_stem(described.name)}-compared")
    names = list(tuned_laws()) if laws.strip() == "all" else [name.strip() for name in laws.split(",") if name.strip()]
    found = compare(described, names or None, jobs=jobs)
    files = found.save(folder, figures)
    if as_json:
        print(json.dumps(tables.comparison_summary(found, files), indent=2, allow_nan=False))
    else:
        tables.print_comparison(found, files)


@app.command()
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
    import yaml

    from tarc.core.errors import TarcError
    from tarc.scenario.model import Scenario
    from tarc.study import search_spaces, tune_all, variation_limit

    names = (
        list(search_spaces()) if laws.strip() == "all" else [name.strip() for name in laws.split(",") if name.strip()]
    )
    training = [Scenario.load(name) for name in scenarios]
    limits = [variation_limit(one, budget) for one in training]
    found = tune_all(names, training, limits, trials=trials, seed=seed, jobs=jobs)
    command = f"tarc tune {' '.join(scenarios)} --laws {laws} --trials {trials} --budget {budget:g} --seed {seed}"
    content = {
        "command": command,
        "limits": {one.name: round(limit, 1) for one, limit in zip(training, limits, strict=True)},
        "scores": {name: round(score, 4) for name, (_, score) in found.items()},
        "laws": {name: part for name, (part, _) in found.items()},
    }
    try:
        out.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120), encoding="utf-8")
    except OSError as error:
        raise TarcError(f"--out: cannot write {out}: {error.strerror or error}; choose another file") from None
    for name, (_, score) in sorted(found.items(), key=lambda item: item[1][1]):
        print(f"{name:20} {score:8.3f}")
    print(f"written: {out}")


@app.command()
def show(
    name: Annotated[str | None, typer.Argument(help="A law, plant, estimator or signal, e.g. TARC.")] = None,
    as_json: Json = False,
) -> None:
    """List the laws, robots, estimators and signals there are, or the parameters of one.

    Example: tarc show TARC
    """
    from tarc.cli import tables

    if name is None:
        tables.print_catalogue(as_json)
    else:
        tables.print_kind(name, as_json)


@app.callback(invoke_without_command=True)
def version(show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    """Handle options before any command."""
    if show_version:
        from tarc.core.version import __version__

        print(__version__)
        raise typer.Exit


def _stem(name: str) -> str:
    """A name as that of one file or folder."""
    return re.sub(r"[^\w.+-]+", "-", str(name)).strip(".-") or "run"


def _run(scenario: Any, out: Path | None, as_json: bool, figures: bool) -> None:
    from tarc.cli import tables

    folder = _folder(out or Path("runs") / _stem(scenario.name))
    try:
        runs = scenario.run()
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        raise typer.Exit(130) from None
    files = save_all(scenario, runs, folder, figures)
    if as_json:
        print(json.dumps(tables.summary(scenario, runs, files), indent=2, allow_nan=False))
    else:
        tables.print_runs(scenario, runs, files)


def _folder(path: Path) -> Path:
    """The folder, made."""
    from tarc.core.errors import TarcError

    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TarcError(f"--out: cannot write to {path}: {error.strerror or error}; choose another folder") from None
    return path


def save_certificates(scenario: Any, found: dict[str, dict[str, Any]], folder: Path, figures: bool) -> list[Path]:
    """Write certificates as JSON, one file a law, and their figures into a folder; the files written."""
    from tarc.core.errors import TarcError

    files = []
    for name, certificates in found.items():
        path = folder / f"{_stem(name)}-certificates.json"
        content = {kind: json.loads(certificate.to_json()) for kind, certificate in certificates.items()}
        try:
            path.write_text(json.dumps(content), encoding="utf-8")
        except OSError as error:
            raise TarcError(f"--out: cannot write {path}: {error.strerror or error}; choose another folder") from None
        files.append(path)
    if figures:
        from rich.console import Console

        from tarc.plotting.certificates import design_figure

        plant, reference = scenario.build_plant(), scenario.build_reference()
        laws = scenario.build_laws(plant, reference)
        with Console(stderr=True).status("drawing figures"):
            for name, certificates in found.items():
                stem = _stem(name)
                picture = folder / f"{stem}-design.png"
                design_figure(laws[name], certificates, scenario.computation_delay).savefig(picture, dpi=110)
                files.append(picture)
                for kind, certificate in certificates.items():
                    picture = folder / f"{stem}-{kind}.png"
                    certificate.plot().savefig(picture, dpi=110)
                    files.append(picture)
    return files


def save_all(scenario: Any, runs: dict[str, Any], folder: Path, figures: bool) -> list[Path]:
    """Write scenario, trajectories and figures into a folder; the files written."""
    from tarc.core.errors import TarcError

    try:
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / "scenario.yaml"
        target.write_text(scenario.to_yaml(), encoding="utf-8")
    except OSError as error:
        raise TarcError(f"--out: cannot write to {folder}: {error.strerror or error}; choose another folder") from None
    files = [target]
    for number, (name, run) in enumerate(runs.items()):
        stem = _stem(name)
        path = folder / f"{stem}.nc"
        files.append(run.save(folder / f"{stem}-{number + 1}.nc" if path in files else path))
    if figures:
        from rich.console import Console

        from tarc.plotting.runs import run_figure

        with Console(stderr=True).status("drawing figures"):
            for kind, name in (("screen", "tracking.png"), ("column", "column.pdf")):
                run_figure(runs, kind).savefig(folder / name, dpi=110)
                files.append(folder / name)
    return files


def _warn(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """A warning as one line."""
    print(f"warning: {message}", file=sys.stderr)


def main() -> None:
    """Run the command line; errors of the user's making are one line and exit status 2."""
    from tarc.core.errors import TarcError

    # matrices here are small, and threads on small matrices wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    warnings.showwarning = _warn
    try:
        app()
    except TarcError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        raise SystemExit(130) from None
