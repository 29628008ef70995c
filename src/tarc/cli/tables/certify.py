"""What `tarc certify` prints."""

import math
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.analysis.workspace import REFERENCE_SPEED_FACTOR
from tarc.certificates.base import Certificate
from tarc.certification import LawCertification
from tarc.cli.tables.console import VERDICT_COLOURS, WIDE, print_written
from tarc.core.formatting import format_vector
from tarc.scenario.certified_laws import CertifiedLaws
from tarc.scenario.certified_regions import CertifiedRegions
from tarc.scenario.model import Scenario

CERTIFICATES = {
    "robot": "this robot, in all postures of the workspace",
    "constant_ratio": "each constant inertia ratio that occurs",
    "sector": "constant ratio, any switching of the robust term",
    "varying_ratio": "any varying ratio, in the widest range",
    "lemma1": "paper, Lemma 1: ‖M(q)⁻¹M̂ − I‖ < 1",
    "c2": "paper, condition (c2): P3 P2ᵀ > 0",
    "theorem1": "paper, Theorem 1: Ψ > 0, nominal",
    "theorem2": "paper, Theorem 2 as printed: Θ > 0",
    "nominal": "Theorem 2 repaired, nominal",
}
"""Claim of each kind of certificate, in the order of the table."""


def _findings(certificate: Certificate) -> dict[str, Any]:
    """Return the plain numbers of the evidence, None for a number that is not finite."""
    evidence = certificate.to_dict()["evidence"]
    flat = {
        key: value
        for content in (evidence, evidence.get("findings") or {}, evidence.get("ball") or {})
        for key, value in content.items()
        if not isinstance(value, dict | list)
    }
    for name in ("rate", "ratio_spread", "method", "decay_rate"):
        if hasattr(certificate.evidence, name):
            flat[name] = getattr(certificate.evidence, name)
    return {key: None if value in ("inf", "-inf", "nan") else value for key, value in flat.items()}


def _decay(certificate: Certificate) -> str:
    """Return the rate at which errors decay at least, empty where none is certified."""
    rate = getattr(certificate.evidence, "decay_rate", None)
    return f"{rate:.3g}" if certificate.certified and rate else ""


def _summary(certificate: Certificate) -> dict[str, Any]:
    """Return a certificate as plain data without its matrices."""
    return {
        "claim": certificate.claim,
        "verdict": certificate.verdict,
        "basis": certificate.basis,
        "margin": certificate.margin if math.isfinite(certificate.margin) else None,
        "margin_meaning": certificate.margin_meaning,
        "proof_grade": certificate.proof_grade,
        "findings": _findings(certificate),
        "witness": certificate.to_dict()["witness"],
        "assumptions": list(certificate.assumptions),
    }


def certificate_summary(
    scenario: Scenario, certifications: CertifiedLaws, files: list[Path], commands: dict[str, str]
) -> dict[str, Any]:
    """Return certificates as plain data, ready for JSON; their matrices are in the files."""
    laws = {
        name: {kind: _summary(certificate) for kind, certificate in certification.certificates.items()}
        for name, certification in certifications.items()
    }
    laws |= {name: {part.kind: _summary(part)} for name, part in certifications.known_inertia.items()}
    return {
        "name": scenario.name,
        "certificates": laws,
        "skipped": certifications.skipped,
        "try": commands,
        "not_certified": scenario.not_certified,
        "files": [str(file) for file in files],
    }


def print_certificates(scenario: Scenario, certifications: CertifiedLaws, *, own_speeds: bool = False) -> None:
    """Print a table per law and its worst postures.

    Parameters
    ----------
    scenario, certifications
        What was certified, and the results.
    own_speeds
        Whether the largest speeds are those of the reference.
    """
    console = Console()
    for name, certification in certifications.items():
        table = Table(title=f"{scenario.name}: {name}", title_justify="left")
        wide = console.width >= WIDE
        decay = "decay [1/s]"
        for column in ("certificate", "verdict", "margin", *(["which is"] if wide else []), decay, "decided in"):
            table.add_column(escape(column), justify="right" if column in ("margin", decay) else "left")
        for kind, certificate in certification.certificates.items():
            if kind == "lemma1":
                table.add_section()
            table.add_row(
                CERTIFICATES[kind],
                f"[{VERDICT_COLOURS[certificate.verdict]}]{certificate.verdict_in_words}[/]",
                f"{certificate.margin:.3g}",
                *([certificate.margin_meaning] if wide else []),
                _decay(certificate),
                "ball arithmetic" if certificate.proof_grade else "floating point",
            )
        console.print(table)
        verdict = certification.verdict
        evidence = verdict.evidence
        for word, ratio, point in (
            ("least", evidence.min_ratio, evidence.points.min_ratio),
            ("greatest", evidence.max_ratio, evidence.points.max_ratio),
        ):
            posture = format_vector(point.position)
            console.print(f"{word} ratio {ratio:.4g} at q = ({posture})", highlight=False)
        ball = evidence.ball
        contained = ""
        if ball is not None and ball.radius:
            contained = f"; the loop tolerates varying ratios from {ball.min_ratio:.4g} to {ball.max_ratio:.4g}"
        spread = f"spread {evidence.ratio_spread:.3g}, from {evidence.samples} postures and local search{contained}"
        console.print(spread, highlight=False)
        if evidence.rate is not None and evidence.max_rate_point is not None:
            speeds = format_vector(evidence.max_rate_point.velocity_limits)
            source = f", {REFERENCE_SPEED_FACTOR:g} times the reference; see --speed" if own_speeds else ""
            rate = f"M changes by at most {evidence.rate:.3g} M̂ per second"
            console.print(f"no joint faster than ({speeds}){source}; {rate}", highlight=False)
        console.print()


def print_strengthened(certifications: dict[str, LawCertification]) -> None:
    """Print the verdicts that a Lyapunov function affine in the inertia has improved, by law."""
    console = Console()
    for name, certification in certifications.items():
        verdict = certification.verdict
        decay = verdict.evidence.decay_rate
        console.print(
            f"{escape(name)} by a Lyapunov function affine in the inertia: "
            f"[{VERDICT_COLOURS[verdict.verdict]}]{verdict.verdict_in_words}[/], margin {verdict.margin:.3g} "
            f"({verdict.margin_meaning}); errors decay as e^(−{decay:.3g} t)",
            highlight=False,
        )


def print_proofs(certifications: CertifiedLaws) -> None:
    """Print the verdicts after the proof over all postures, and each bound with its proven share, by law."""
    console = Console()
    for name, certification in certifications.items():
        if certification.proof is None:
            console.print(f"{escape(name)}: not certified, so that there is nothing to prove", highlight=False)
            continue
        verdict = certification.verdict
        console.print(
            f"{escape(name)}: [{VERDICT_COLOURS[verdict.verdict]}]{verdict.verdict_in_words}[/]", highlight=False
        )
        for part in certification.proof.parts:
            console.print(f"  {escape(str(part))}", highlight=False)
    for name in certifications.known_inertia:
        console.print(f"{escape(name)}: with M̂(q) the verdict rests on samples and search", highlight=False)


def print_suggestions(
    scenario: Scenario, certifications: CertifiedLaws, files: list[Path], commands: dict[str, str]
) -> None:
    """Print what to change in laws that are not certified, what was skipped, and the files.

    Parameters
    ----------
    scenario, certifications, files
        What was certified, the results, and where they are.
    commands
        Commands by law that certify it with other gains.
    """
    console = Console()
    for name, certification in certifications.items():
        text = certification.suggestion
        if text:
            colour = VERDICT_COLOURS[certification.verdict.verdict]
            console.print(f"{escape(name)}: [{colour}]{escape(text)}[/]", highlight=False)
        if name in commands:
            console.print(f"Try: {escape(commands[name])}", highlight=False, soft_wrap=True)
    for name, certificate in certifications.known_inertia.items():
        colour = VERDICT_COLOURS[certificate.verdict]
        console.print(f"{escape(scenario.name)}: {escape(name)}", highlight=False)
        console.print(f"[{colour}]{escape(certificate.explain())}[/]\n", highlight=False)
    for name, reason in certifications.skipped.items():
        console.print(f"[yellow]{escape(name)} is skipped: {escape(reason)}[/]", highlight=False)
    if scenario.not_certified:
        parts = ", ".join(scenario.not_certified)
        console.print(f"[yellow]in the scenario, and covered by no certificate: {escape(parts)}[/]", highlight=False)
    print_written(console, files)


def print_regions(scenario: Scenario, regions: CertifiedRegions, files: list[Path]) -> None:
    """Print from which errors each law recovers, what they never exceed and where they end."""
    console = Console(width=None if Console().is_terminal else WIDE)
    heads = "law", "verdict", "recovers from", "never exceeds", "ends below", "decay rate \\[1/s]"
    table = Table(*heads, title=escape("Largest errors of single joints [rad or m]"), title_justify="left")
    for name, certificate in regions.items():
        evidence, verdict = certificate.evidence, certificate.verdict
        cells = [""] * 4
        if certificate.certified and evidence.proof is not None:
            errors = evidence.start_errors, evidence.tube_errors, evidence.final_errors
            cells = [f"({format_vector(part, digits=3)})" for part in errors] + [f"{evidence.proof.decay_rate:.3g}"]
        table.add_row(escape(name), f"[{VERDICT_COLOURS[verdict]}]{verdict}[/]", *cells)
    console.print(table)
    for name, reason in regions.skipped.items():
        console.print(f"{name}: {reason}", markup=False, highlight=False)
    if any(not certificate.certified for certificate in regions.values()):
        console.print("Inconclusive: try a larger or a smaller --region, a shorter window or another M̂.")
    if scenario.not_certified:
        console.print(f"Not covered: {', '.join(scenario.not_certified)}.", highlight=False)
    console.print("The robot in the tube rests on samples and local search; tarc verify lists all that is assumed.")
    print_written(console, files)


def region_summary(scenario: Scenario, regions: CertifiedRegions, files: list[Path]) -> dict[str, Any]:
    """Return the same as plain data, ready for JSON."""

    def summary(certificate: Certificate[Any]) -> dict[str, Any]:
        evidence = certificate.evidence
        errors = {name: getattr(evidence, name).tolist() for name in ("start_errors", "tube_errors", "final_errors")}
        return _summary(certificate) | (errors if certificate.certified else {})

    return {
        "name": scenario.name,
        "regions": {name: summary(certificate) for name, certificate in regions.items()},
        "skipped": regions.skipped,
        "not_certified": scenario.not_certified,
        "files": [str(file) for file in files],
    }
