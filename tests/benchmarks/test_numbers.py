"""Every marked number of README and the pages comes from a source, and stands there as it was computed."""

import pytest
from benchmarks.numbers import fill, load, names, pages, spell
from benchmarks.page_values import SOURCES

ALL_PAGES = pytest.mark.parametrize("page", pages(), ids=lambda path: path.name)


@ALL_PAGES
def test_every_marker_has_a_source_and_a_value(page):
    values = load()
    for name in names(page.read_text(encoding="utf-8")):
        source, _, key = name.partition(".")
        assert source in SOURCES, name
        assert key in values[source], f"{name}: run python -m benchmarks.numbers {source}"


@ALL_PAGES
def test_page_has_the_values_that_were_computed(page):
    text = page.read_text(encoding="utf-8")
    assert fill(text, load()) == text, "run python -m benchmarks.numbers --write-only"
    for kind in ("number", "block"):
        assert text.count(f"<!-- {kind}: ") == text.count(f"<!-- /{kind} -->")
    assert "\n<!-- number: " not in text, "a marker at the start of a line ends the paragraph on the site"


def test_every_kept_value_has_a_source():
    assert set(load()) <= set(SOURCES)


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (1.20915, None, "1.209"),
        (1.20915, "2", "1.2"),
        (410.541, ".1f", "410.5"),
        (68284.1, "4", "68\N{NO-BREAK SPACE}280"),
        (-0.5, "2", "\N{MINUS SIGN}0.5"),
        ("a table", None, "a table"),
    ],
)
def test_spelling(value, form, text):
    assert spell(value, form) == text
