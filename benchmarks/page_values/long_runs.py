"""Values of the long benchmarks: designs for six arms, and all laws in ten scenarios."""

import csv
import re
import subprocess
import sys
from pathlib import Path

from benchmarks.page_values.registry import ROOT, Value, long_source, table

TABLE = re.compile(r"(?:^\|.*\|\n)+", re.MULTILINE)


def run_benchmark(module: str) -> None:
    """Run a module of `benchmarks` in the repository's folder, where it keeps its results in ``runs``."""
    subprocess.run([sys.executable, "-m", module], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def tables(file: Path) -> dict[str, str]:
    """Return the tables of a Markdown file by the line before them."""
    text = file.read_text(encoding="utf-8")
    named = {}
    for match in TABLE.finditer(text):
        title = text[: match.start()].strip().splitlines()[-1].rstrip(":")
        named[title] = match[0].strip()
    return named


@long_source
def comparison() -> dict[str, Value]:
    """Errors and torque variations of all laws in ten scenarios; the pages of the laws are written too."""
    run_benchmark("benchmarks.comparison")
    run_benchmark("benchmarks.pages")
    named = tables(ROOT / "runs" / "comparison" / "comparison.md")
    errors, variations = (
        next(text for title, text in named.items() if word in title) for word in ("error", "variation")
    )
    return {"errors": errors, "variations": variations}


@long_source
def six_arms() -> dict[str, Value]:
    """Designs for six arms, and hand-picked gains beside them."""
    run_benchmark("benchmarks.design")
    folder = ROOT / "runs" / "design"
    named = tables(folder / "design.md")
    designs = next(text for title, text in named.items() if "Certified" in title)
    designs = re.sub(r"\d+, CPU", "CPU", designs).replace("ωn", r"$\omega_{n}$").replace("Λ", r"$\Lambda$")
    return {"designs": designs, "picks": _picks(folder / "picks.csv", folder / "designs.csv")}


@long_source
def not_covered() -> dict[str, Value]:
    """Lag, delay, jitter, rate, elasticity and backlash that the designs for six arms stand."""
    run_benchmark("benchmarks.not_covered")
    text = (ROOT / "runs" / "not_covered" / "limits.md").read_text(encoding="utf-8")
    return {"limits": text.strip()}


SWEEP_WORDS = {
    "m I": r"$\hat{M}$ = m I",
    "m diag": r"$\hat{M}$ = m diag",
    "any ωn": "natural frequency too",
    "checked": "and stable at rest",
}
VERDICT_WORDS = {"refuted": "unstable at rest somewhere"}


def _picks(picks: Path, designs: Path) -> str:
    """Return the table of hand picks: one row for each sweep."""
    own = {row["name"]: float(row["error"]) for row in _rows(designs)}
    found = [row for row in _rows(picks) if row["sweep"] in SWEEP_WORDS and row["error"] not in ("", "nan")]
    rows = []
    for sweep, words in SWEEP_WORDS.items():
        chosen = [row for row in found if row["sweep"] == sweep]
        ratios = [f"{float(row['error']) / own[row['name']]:.2g} {row['name']}" for row in chosen]
        verdicts = [
            f"{VERDICT_WORDS.get(verdict, verdict)}: {', '.join(names)}"
            for verdict in ("certified", "inconclusive", "refuted")
            if (names := [row["name"] for row in chosen if row["verdict"] == verdict])
        ]
        rows.append((words, ", ".join(ratios), "; ".join(verdicts)))
    return table(["hand-picked", "error, as a multiple of the design's", "over the workspace"], rows)


def _rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


@long_source
def optimum() -> dict[str, Value]:
    """Errors of laws with their best parameters over the least ones; the page's figure is drawn too."""
    from benchmarks import optimum as search

    found = search.rows()
    search.figure(found).savefig(ROOT / "docs" / "images" / "optimum.png", dpi=110)
    names = [kind.name for kind in search.KINDS]
    laws = [
        (
            f"{row.walk:g}",
            f"{row.budget:g}",
            f"{row.least / search.NOISE:.3g}",
            *(f"{row.over(name):.2f}" for name in names),
        )
        for row in found
    ]
    free = [
        (
            f"{row.walk:g}",
            f"{row.budget:g}",
            f"{row.laws[search.LITERAL].window}",
            f"{row.over(search.LITERAL):.3f}",
            f"{row.free:.3f}",
            f"{row.equal:.3f}",
            f"{row.law_spread:.2g}",
            f"{row.free_spread:.2g}",
            f"{row.equal_spread:.2g}",
        )
        for row in found
    ]
    units = ["walk [rad/s²]", "change [rad/s²]"]
    heads = [*units, "window", "polynomial", "free", "free, as robust"]
    heads += [f"spread, {one}" for one in ("polynomial", "free", "free, as robust")]
    return {"laws": table([*units, "least error / σ", *names], laws), "free": table(heads, free)}


@long_source
def adaptive_term() -> dict[str, Value]:
    """Errors of TARC and TDC with M̂(q) where friction and load differ from the design; the figure is drawn too."""
    from benchmarks import adaptive_term as benchmark

    results = benchmark.run_all()
    benchmark.save(results, ROOT / "runs" / "adaptive_term")
    benchmark.figure(results).savefig(ROOT / "docs" / "images" / "adaptive-term.png", dpi=110)
    chosen = [label.split("; ") for label in benchmark.chosen(results).values()]
    slopes = [
        (
            f"{frequency:g}",
            f"{benchmark.CERTIFIED_SLOPES[frequency]:g}",
            verdict,
            f"{benchmark.slope_bound(frequency):.0f}",
        )
        for frequency, verdict in benchmark.verdicts().items()
    ]
    heads = [
        "natural frequency [rad/s]",
        "slope [1/s²]",
        "verdict with M̂(q)",
        "circle criterion, constant ratio [1/s²]",
    ]
    return {
        "slopes": table(heads, slopes),
        "cases": table(benchmark.HEADS, benchmark.rows(results)),
        "chosen": table(["law", "gains chosen as designed"], chosen),
    }


@long_source
def three_questions() -> dict[str, Value]:
    """Compare what is certified with what breaks, for spread, rate and stiffness; draw the figures too."""
    from benchmarks import three_questions as questions

    much, fast, stiff = questions.how_much(), questions.how_fast(), questions.stiffnesses()
    for name, drawn in questions.figures(much, fast, stiff).items():
        drawn.savefig(ROOT / "docs" / "images" / f"{name}.png", dpi=110)
    shares = {
        "much": min(row.certified / row.broken for row in much),
        "fast": min(max(row.ball, row.affine) / row.broken for row in fast),
        "stiff": min(row.certified / row.broken for row in stiff),
    }
    return {f"{name}_share": 100 * share for name, share in shares.items()}


@long_source
def certificate_losses() -> dict[str, Value]:
    """Certify arms with parts of the certificate left out."""
    from benchmarks import certificate_losses as benchmark

    columns = {name: list(benchmark.losses(name)) for name in benchmark.NAMES}
    rows = zip(*columns.values(), strict=True)
    cells = [(row[0].left_out, *(f"{loss.share:.2f}" for loss in row)) for row in rows]
    return {"shares": table(["left out", *columns], cells)}


@long_source
def attacks() -> dict[str, Value]:
    """Attack the loops of eight arms with the designs of two revisions, beyond what is certified as well."""
    from benchmarks import attacks as benchmark

    options = ["--designs", str(benchmark.FIRST_DESIGNS)]
    for further in (options, []):
        subprocess.run([sys.executable, "-m", "benchmarks.attacks", *further], cwd=ROOT, check=True)
    found = benchmark.known_results(benchmark.RESULTS)
    rows = [
        (
            one.name,
            one.designs,
            f"{one.certified:.3g}",
            one.route,
            f"{one.broken_at:.3g}",
            f"{one.share:.2f}",
            f"{one.broken} of {one.attacks}",
            f"{one.failed} of {one.runs}",
        )
        for one in found
    ]
    heads = ["arm", "design of", "certified [rad/s]", "by", "broken at [rad/s]", "share"]
    heads += ["broken by motions", "failed runs"]
    return {
        "arms": table(heads, rows),
        "count": float(sum(one.attacks + one.runs for one in found)),
        "broken": float(sum(one.broken + one.failed for one in found)),
        "revision": "`" + "`, `".join(dict.fromkeys(one.revision for one in found)) + "`",
    }
