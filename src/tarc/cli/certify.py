"""`tarc certify`: certify a scenario's laws."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import Figures, Json, Out, Set, file_stem, numbers_of
from tarc.core.files import make_folder, writing

if TYPE_CHECKING:
    from tarc.certification import LawCertification


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
    folder = make_folder("--out", out or Path("runs") / file_stem(described.name))
    swift, steep = numbers_of("--speed", speed), numbers_of("--acceleration", acceleration)
    setup = described.build()
    found = described.certify_setup(
        setup, tube=tube, full_range=full_range, speed=swift, acceleration=steep, samples=samples
    )
    files = save_certificates(found, folder, figures)
    from tarc.cli import tables

    if as_json:
        print(json.dumps(tables.certificate_summary(described, found, files), indent=2, allow_nan=False))
    else:
        tables.print_certificates(described, found, files)


def save_certificates(found: dict[str, "LawCertification"], folder: Path, figures: bool) -> list[Path]:
    """Write certificates as JSON, one file a law, and their figures into a folder; the files written."""
    files = []
    for name, certification in found.items():
        path = folder / f"{file_stem(name)}-certificates.json"
        content = {kind: certificate.to_dict() for kind, certificate in certification.certificates.items()}
        with writing("--out", path):
            path.write_text(json.dumps(content), encoding="utf-8")
        files.append(path)
    if figures:
        from rich.console import Console

        from tarc.plotting.certificates import design_figure

        with Console(stderr=True).status("drawing figures"):
            for name, certification in found.items():
                stem = file_stem(name)
                picture = folder / f"{stem}-design.png"
                design_figure(certification).savefig(picture, dpi=110)
                files.append(picture)
                for kind, certificate in certification.certificates.items():
                    picture = folder / f"{stem}-{kind}.png"
                    certificate.plot().savefig(picture, dpi=110)
                    files.append(picture)
    return files
