"""`tarc certify`: certify a scenario's laws."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import (
    Figures,
    FullRange,
    Json,
    LawKind,
    Out,
    ScenarioName,
    Set,
    Speed,
    Tube,
    drawing_figures,
    file_stem,
    numbers_of,
)
from tarc.core.files import make_folder, writing

if TYPE_CHECKING:
    from tarc.scenario.certified_laws import CertifiedLaws
    from tarc.scenario.model import Scenario

Acceleration = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS",
        help="Largest joint acceleration \\[rad/s² or m/s²]. Default: reaches a given speed in 0.25 s.",
    ),
]
Quick = Annotated[
    bool,
    typer.Option(
        "--quick",
        help="Leave out what takes seconds: the Lyapunov function affine in the inertia, and the search for a command "
        "that certifies a law.",
    ),
]
Prove = Annotated[
    bool,
    typer.Option(
        "--prove",
        help="Prove what certified laws take from samples and search, for every posture, by branch and bound. Ctrl-C "
        "keeps what is proven, and the same command goes on. It is kept in $XDG_CACHE_HOME/tarc/proofs, by default "
        "~/.cache/tarc/proofs.",
    ),
]
ProveTime = Annotated[
    float,
    typer.Option(
        metavar="SECONDS",
        min=0.001,
        help="Time of --prove for each law. What is left then is printed, and the same command goes on.",
    ),
]
Region = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS",
        help="Certify the nonlinear robot along the reference instead: from which errors each law recovers, without an "
        "error above this \\[rad or m], one number or one per joint.",
    ),
]
TorqueRate = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS", help="With --region: largest rate of a disturbing torque \\[N m/s or N/s]. Default: 0."
    ),
]
Samples = Annotated[int, typer.Option(help="Number of sampled postures, before the local search for worse ones.")]


def certify(
    scenario: ScenarioName,
    set_: Set = None,
    law: LawKind = "",
    out: Out = None,
    tube: Tube = 0.01,
    full_range: FullRange = False,
    speed: Speed = "",
    acceleration: Acceleration = "",
    samples: Samples = 2000,
    quick: Quick = False,
    prove: Prove = False,
    prove_time: ProveTime = 600.0,
    region: Region = "",
    torque_rate: TorqueRate = "",
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Certify a scenario's laws on its robot: is each stable in every posture, and with which margin?

    Each claim is certified, refuted or inconclusive. The first row of the
    table is the verdict for the robot. The next rows are what it rests on.
    The last rows are the conditions of the paper. The postures are those of
    the reference and a tube about it, or all with --full-range.

    A Lyapunov function affine in the inertia is then tried for each law that
    is not certified with a margin. Where it is not either, settings that
    certify the law are searched for and printed. --quick leaves out both.

    A verdict says on how many sampled postures it rests. With --prove it says
    for every posture, or which share of them is proven in --prove-time.

    --region 0.1 certifies how large an error each law recovers from, with a
    bound that the errors never exceed and one below which they end.

    Example: tarc certify ur5e --set law.synchronised=true --set law.inertia.fraction=0.5
    """
    from tarc.cli.tables import certify as tables
    from tarc.scenario.model import Scenario

    loaded = Scenario.load(scenario, set_ or [], law=law)
    folder = make_folder("--out", out or Path("runs") / file_stem(loaded.name))
    if region:
        certify_regions(loaded, folder, region, torque_rate, as_json=as_json, figures=figures)
        return
    certifications = loaded.certify(
        tube=tube,
        full_range=full_range,
        speed=numbers_of("--speed", speed),
        acceleration=numbers_of("--acceleration", acceleration),
        samples=samples,
    )
    if not as_json:
        tables.print_certificates(loaded, certifications, own_speeds=not (speed or full_range))
    if not quick:
        strengthened = certifications.strengthen()
        if not as_json:
            tables.print_strengthened(strengthened)
    if prove:
        prove_postures(certifications, prove_time, quiet=as_json)
    files = save_certificates(certifications, folder)
    if figures:
        files += save_figures(certifications, folder)
    commands = {} if quick else certifying_commands(loaded, certifications)
    if as_json:
        print(
            json.dumps(tables.certificate_summary(loaded, certifications, files, commands), indent=2, allow_nan=False)
        )
    else:
        tables.print_suggestions(loaded, certifications, files, commands)


def certify_regions(
    scenario: "Scenario", folder: Path, region: str, torque_rate: str, *, as_json: bool, figures: bool
) -> None:
    """Certify regions of attraction, print them, and write certificates and figures."""
    from tarc.cli.tables import certify as tables

    rate = numbers_of("--torque-rate", torque_rate)
    max_error = numbers_of("--region", region)
    assert max_error is not None
    regions = scenario.certify_regions(max_error, torque_rate=0.0 if rate is None else rate)
    files = []
    for name, certificate in regions.items():
        files.append(folder / f"{file_stem(name)}-region.json")
        with writing("--out", files[-1]):
            files[-1].write_text(json.dumps({certificate.kind: certificate.to_dict()}), encoding="utf-8")
        if figures:
            files.append(folder / f"{file_stem(name)}-region.png")
            with drawing_figures(), writing("--out", files[-1]):
                certificate.plot().savefig(files[-1], dpi=110)
    if as_json:
        print(json.dumps(tables.region_summary(scenario, regions, files), indent=2, allow_nan=False))
    else:
        tables.print_regions(scenario, regions, files)


def prove_postures(certifications: "CertifiedLaws", time_limit: float, *, quiet: bool) -> None:
    """Prove the certificates for every posture, and print what is proven.

    Raises
    ------
    KeyboardInterrupt
        For Ctrl-C, after the folder in which open boxes are kept is printed.
    """
    from tarc.analysis.stored_proof import proofs_folder
    from tarc.cli.tables import certify as tables

    try:
        certifications.prove(time_limit)
    except KeyboardInterrupt:
        print(f"What is proven is kept in {proofs_folder()}; the same command goes on.", file=sys.stderr)
        raise
    if not quiet:
        tables.print_proofs(certifications)


def certifying_commands(scenario: "Scenario", certifications: "CertifiedLaws") -> dict[str, str]:
    """Return for each law that was not certified this command with settings that certify it, where any were found."""
    from tarc.scenario.repair import certifying_settings

    commands = {}
    for name, certification in certifications.items():
        if not certification.verdict.certified:
            settings = certifying_settings(scenario, certifications, name)
            options = [word for setting in settings for word in ("--set", setting)]
            if options:
                commands[name] = shlex.join(["tarc", *sys.argv[1:], *options])
    return commands


def save_certificates(certifications: "CertifiedLaws", folder: Path) -> list[Path]:
    """Write certificates as JSON into a folder, one file per law; return the files."""
    files = []
    for name, certification in certifications.items():
        path = folder / f"{file_stem(name)}-certificates.json"
        content = {kind: certificate.to_dict() for kind, certificate in certification.certificates.items()}
        with writing("--out", path):
            path.write_text(json.dumps(content), encoding="utf-8")
        files.append(path)
    for name, certificate in certifications.known_inertia.items():
        path = folder / f"{file_stem(name)}-certificates.json"
        with writing("--out", path):
            path.write_text(json.dumps({certificate.kind: certificate.to_dict()}), encoding="utf-8")
        files.append(path)
    return files


def save_figures(certifications: "CertifiedLaws", folder: Path) -> list[Path]:
    """Write the figures of each law into a folder: its design, its certificates, the conditions of the paper."""
    from tarc.plotting.certificates import FIGURES, conditions_figure, design_figure

    files = []
    with drawing_figures(), writing("--out", folder):
        for name, certification in certifications.items():
            certificates = certification.certificates
            figures = {"design": design_figure(certification)}
            figures |= {kind: certificate.plot() for kind, certificate in certificates.items() if kind in FIGURES}
            conditions = [certificate for kind, certificate in certificates.items() if kind not in FIGURES]
            figures["paper"] = conditions_figure(conditions)
            for kind, figure in figures.items():
                files.append(folder / f"{file_stem(name)}-{kind}.png")
                figure.savefig(files[-1], dpi=110, pil_kwargs={"compress_level": 1})
    return files
