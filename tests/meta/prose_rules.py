"""Rules of prose, as functions: the sentences of a docstring or page, and what is wrong with them."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

MAX_WORDS = 25
MAX_WORDS_IN_NOTES = 30
BANNED = {
    "bear, borne": r"\b(bears?|borne|bearing the)\b",
    "told, heard": r"\b(told|heard)\b",
    "asked for": r"\basked for\b",
    "apart": r"\bapart\b",
    "a joint for per joint": r"\b(one|number|numbers|name|row|value|ones|them|range|offset) a joint\b",
    "a second for per second": r"\b\w+s a second\b(?! (time|look|writing))",
    "so many": r"\bso many\b",
    "what … makes of …": r"\bwhat .{1,30} makes? of\b",
    "one that does not": r"\bone that does not\b",
    "whatever it": r"\bwhatever it\b",
    "holds the robot": r"\bholds the robot\b",
}
SECTIONS = (
    "Parameters",
    "Attributes",
    "Returns",
    "Raises",
    "Warns",
    "Notes",
    "References",
    "Examples",
    "Yields",
    "Methods",
)
ENTRIES = ("Parameters", "Attributes", "Returns", "Raises", "Warns", "Yields", "Methods")


class Problem(NamedTuple):
    """Where a sentence is, what is wrong with it, and its text."""

    place: str
    rule: str
    text: str


def words(sentence: str) -> int:
    """Return number of words: what has two letters or more; code counts as one, formulas not at all."""
    plain = re.sub(r"`+[^`]*`+", " code ", sentence)
    plain = re.sub(r"\$[^$]*\$", " ", plain)
    return sum(bool(re.search(r"[A-Za-zäöüß]{2}|^[AaI]$", token)) for token in plain.split())


def sentences(paragraph: str) -> list[str]:
    """Sentences of a paragraph; a full stop, question or exclamation mark ends one."""
    text = re.sub(r"\b(e\.g|i\.e|cf|vs|Eq|Sec|Fig|No|et al|approx)\.", r"\1", " ".join(paragraph.split()))
    return [part for part in re.split(r"(?<=[.?!])[)\"”']?\s+(?=[\"“(`A-ZÄÖÜ0-9‖|\[*])", text) if part]


def problems_in(place: str, paragraphs: Iterator[str], limit: int = MAX_WORDS) -> list[Problem]:
    """Long sentences and banned words."""
    result = []
    for paragraph in paragraphs:
        result += [
            Problem(place, f"{words(sentence)} words", sentence)
            for sentence in sentences(paragraph)
            if words(sentence) > limit
        ]
        plain = re.sub(r"`+[^`]*`+", " ", paragraph)
        result += [
            Problem(place, f"banned: {rule}", " ".join(plain.split()))
            for rule, pattern in BANNED.items()
            if re.search(pattern, plain, re.IGNORECASE)
        ]
    return result


def docstring_paragraphs(text: str) -> Iterator[str]:
    """Prose of a docstring: no formulas, code, names of parameters or references."""
    section, lines, block = "", text.expandtabs().splitlines(), []
    indents = [len(line) - len(line.lstrip()) for line in lines[1:] if line.strip()]
    base = min(indents, default=0)
    lines = [lines[0].strip(), *(line[base:] for line in lines[1:])] if lines else []
    for number, line in enumerate([*lines, ""]):
        underlined = number + 1 < len(lines) and set(lines[number + 1].strip()) == {"-"}
        indented = line.startswith(" ")
        formula = indented and section not in ENTRIES
        name = not indented and section in ENTRIES
        deep = line.startswith("        ") and section in ENTRIES
        if not line.strip() or underlined or set(line.strip()) == {"-"} or formula or name or deep or ">>>" in line:
            if block and section not in ("References", "Examples"):
                yield " ".join(block)
            block = []
            if underlined:
                section = line.strip()
            continue
        block.append(line.strip())


def source_problems(file: Path) -> list[Problem]:
    """Problems in the docstrings of a module, also those below constants."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    result = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            place = f"{file}:{node.lineno}"
            result += problems_in(place, docstring_paragraphs(node.value.value))
    return result


def page_paragraphs(text: str) -> Iterator[str]:
    """Prose of a page in Markdown: no code, tables, headings, formulas or HTML; each item of a list by itself."""
    text = re.sub(r"(?ms)^ *(```|~~~).*?^ *\1 *$", "", text)
    text = re.sub(r"(?s)<!--.*?-->|\$\$.*?\$\$|<svg.*?</svg>", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    block: list[str] = []
    for line in [*text.splitlines(), ""]:
        stripped = line.strip()
        item = re.match(r"([-*+]|\d+\.)\s+", stripped)
        skip = not stripped or stripped.startswith(("|", "#", "<", ":::", "!!!", "???", "---", "!["))
        if skip or item:
            if block:
                yield " ".join(block)
            block = []
        if not skip:
            block.append(re.sub(r"^([-*+]|\d+\.)\s+", "", stripped))


def page_problems(file: Path) -> list[Problem]:
    """Problems on a page."""
    return problems_in(str(file), page_paragraphs(file.read_text(encoding="utf-8")))
