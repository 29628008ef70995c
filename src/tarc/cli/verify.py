"""`tarc verify`: judge the certificates of files again."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tarc.cli.options import Json

if TYPE_CHECKING:
    from tarc.certificates import Certificate

CertificateFiles = Annotated[
    list[Path], typer.Argument(metavar="FILES", help="JSON of tarc certify, tarc design or Certificate.to_json.")
]


def verify(files: CertificateFiles, as_json: Json = False) -> None:
    """Judge certificates again, from the matrices in their files alone and without any solver.

    Each line has the kind, the verdict in the file, and whether its evidence
    gives that verdict again. What a verdict assumes is printed below it. The
    exit status is 1 where any evidence does not give its verdict.

    Example: tarc verify runs/ur5e/TARC-certificates.json
    """
    from tarc.core.progress import Progress

    certificates = [(file, name, certificate) for file in files for name, certificate in certificates_of(file)]
    results = []
    with Progress("judging certificates", len(certificates)) as bar:
        for _, _, certificate in certificates:
            results.append(certificate.verify())
            bar.advance()
    if as_json:
        rows = [
            {
                "file": str(file),
                "kind": name,
                "verdict": certificate.verdict,
                "holds": holds,
                "proof_grade": certificate.proof_grade,
                "assumptions": list(certificate.assumptions),
            }
            for (file, name, certificate), holds in zip(certificates, results, strict=True)
        ]
        print(json.dumps(rows, indent=2))
    else:
        _print_results(certificates, results)
    if not all(results):
        raise typer.Exit(1)


def certificates_of(file: Path) -> "Iterator[tuple[str, Certificate]]":
    """Yield the certificates of a file, each with its name: one, or several by name.

    Raises
    ------
    InvalidParameter
        For a file that cannot be read, and one without certificates.
    """
    from tarc.core.errors import InvalidParameter
    from tarc.stored_certificates import certificate_from_dict

    try:
        content: Any = json.loads(file.expanduser().read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidParameter(f"FILES: {file} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise InvalidParameter(f"FILES: {file} is no JSON ({error}); needs a file of tarc certify") from None
    if isinstance(content, dict) and "kind" in content:
        content = {str(content["kind"]): content}
    if not isinstance(content, dict) or not content:
        raise InvalidParameter(f"FILES: {file} has no certificates; needs a file of tarc certify or tarc design")
    for name, part in content.items():
        try:
            yield name, certificate_from_dict(part)
        except InvalidParameter as error:
            raise InvalidParameter(f"FILES: {file}: {name}: {error}") from None


def _print_results(certificates: "list[tuple[Path, str, Certificate]]", results: list[bool]) -> None:
    """Print each result with what it assumes; assumptions that several share only once."""
    last, printed = None, set[str]()
    for (file, name, certificate), holds in zip(certificates, results, strict=True):
        if file != last:
            print(f"{file}:")
            last = file
        grade = ", in ball arithmetic" if certificate.proof_grade else ""
        outcome = "holds" if holds else "DOES NOT HOLD: the evidence gives another verdict"
        print(f"  {name:16} {certificate.verdict:13} {outcome}{grade if holds else ''}")
        for assumption in certificate.assumptions:
            if assumption not in printed:
                print(f"      assumes: {assumption}")
                printed.add(assumption)
    print(f"{sum(results)} of {len(results)} verdicts hold")
