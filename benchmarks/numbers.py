"""Numbers of README and the pages, each from a run: ``python -m benchmarks.numbers``, or ``make numbers``.

A page marks where a value stands:

    <!-- number: SOURCE.KEY FORMAT -->1.21<!-- /number -->
    <!-- block: SOURCE.KEY -->

    a table, between empty lines

    <!-- /block -->

SOURCE is a function of `benchmarks.page_values`, which returns its values by key. FORMAT is a number of significant
digits (4 if left out) or a format of Python such as ``.2f``. The values are kept in ``docs/numbers.json``, from which
``--write-only`` fills the pages without a run.
"""

import argparse
import json
import re
import time
import warnings
from collections.abc import Iterable
from pathlib import Path

from benchmarks.page_values import SOURCES, Value
from benchmarks.page_values.registry import DataMissingError
from tarc import DesignWarning

ROOT = Path(__file__).resolve().parents[1]
VALUES = ROOT / "docs" / "numbers.json"
NUMBER = re.compile(r"<!-- number: (?P<name>[\w.-]+)(?: (?P<format>\S+))? -->(?P<text>.*?)<!-- /number -->", re.DOTALL)
BLOCK = re.compile(r"<!-- block: (?P<name>[\w.-]+) -->\n\n(?P<text>.*?)\n\n<!-- /block -->", re.DOTALL)


def pages() -> list[Path]:
    """Return README and the pages of the documentation."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def load() -> dict[str, dict[str, Value]]:
    """Return the values that are kept, by source and key."""
    return json.loads(VALUES.read_text(encoding="utf-8")) if VALUES.is_file() else {}


def save(values: dict[str, dict[str, Value]]) -> None:
    """Keep the values, numbers with six digits, so that other machines write the same file."""
    rounded = {source: {key: _rounded(value) for key, value in part.items()} for source, part in values.items()}
    text = json.dumps(rounded, indent=1, sort_keys=True, ensure_ascii=False)
    VALUES.write_text(text + "\n", encoding="utf-8")


def _rounded(value: Value) -> Value:
    return value if isinstance(value, str) else float(f"{value:.6g}")


def spell(value: Value, form: str | None = None) -> str:
    """Return a value as a page has it: significant digits, or a format of Python; groups of three from 10 000 on."""
    if isinstance(value, str):
        return value
    digits = form or "4"
    text = f"{float(f'{value:.{digits}g}'):.12g}" if digits.isdigit() else f"{value:{digits}}"
    if re.fullmatch(r"-?\d{5,}", text):
        text = f"{int(text):,}".replace(",", "\N{NO-BREAK SPACE}")
    return text.replace("-", "\N{MINUS SIGN}", 1) if text.startswith("-") else text


def fill(text: str, values: dict[str, dict[str, Value]]) -> str:
    """Return a page with its values written again; `KeyError` names a value that no source has given yet."""

    def look_up(name: str) -> Value:
        source, _, key = name.partition(".")
        return values[source][key]

    def number(match: re.Match[str]) -> str:
        begin = match[0][: match.start("text") - match.start()]
        return f"{begin}{spell(look_up(match['name']), match['format'])}<!-- /number -->"

    def block(match: re.Match[str]) -> str:
        return f"<!-- block: {match['name']} -->\n\n{look_up(match['name'])}\n\n<!-- /block -->"

    return BLOCK.sub(block, NUMBER.sub(number, text))


def names(text: str) -> list[str]:
    """Return the names of the values of a page."""
    return [match["name"] for pattern in (NUMBER, BLOCK) for match in pattern.finditer(text)]


def write(values: dict[str, dict[str, Value]]) -> list[Path]:
    """Fill the pages; return those that changed."""
    changed = []
    for page in pages():
        before = page.read_text(encoding="utf-8")
        after = fill(before, values)
        if after != before:
            page.write_text(after, encoding="utf-8")
            changed.append(page)
    return changed


def compute(sources: Iterable[str], values: dict[str, dict[str, Value]]) -> None:
    """Run sources and keep what each gives as soon as it is there."""
    for name in sources:
        begin = time.perf_counter()
        print(f"{name} …", end=" ", flush=True)
        try:
            values[name] = SOURCES[name].function()
        except DataMissingError as missing:
            print(f"skipped: {missing}; the page keeps its values")
            continue
        save(values)
        print(f"{time.perf_counter() - begin:.0f} s", flush=True)


def main() -> None:
    """Compute what was named and fill the pages."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.numbers", description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "sources", nargs="*", metavar="SOURCE", help=f"some of {', '.join(SOURCES)}; default the short ones"
    )
    parser.add_argument("--all", action="store_true", help="the long ones too, of which soundness takes hours")
    parser.add_argument("--write-only", action="store_true", help="fill the pages from the values that are kept")
    options = parser.parse_args()
    unknown = set(options.sources) - set(SOURCES)
    if unknown:
        parser.error(f"got {', '.join(sorted(unknown))}; needs some of {', '.join(SOURCES)}")
    values = load()
    warnings.simplefilter("ignore", DesignWarning)  # many pages show designs that fail
    if not options.write_only:
        default = [name for name, source in SOURCES.items() if options.all or not source.long]
        compute(options.sources or default, values)
    for page in write(load()):  # as they are kept, so that a second time writes the same
        print(f"written: {page.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
