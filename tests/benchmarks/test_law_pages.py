"""Each law has a page in the documentation, whole and up to date."""

import inspect
import re
from dataclasses import fields
from pathlib import Path

import pytest
from benchmarks.pages import equation, rounded

from law_catalogue import concrete_laws
from tarc.scenario.yaml_text import read_yaml
from tarc.study import tuned_laws

DOCS = Path(__file__).parents[2] / "docs"
SECTIONS = ["The equation", "Choosing its parameters", "When to use it", "In the benchmark"]
every_law = pytest.mark.parametrize("kind", concrete_laws(), ids=lambda kind: kind.__name__)


def page_text(kind):
    path = DOCS / "laws" / f"{kind.__name__}.md"
    assert path.is_file(), f"{kind.__name__} has no page; begin {path} as a copy of another law's"
    return path.read_text(encoding="utf-8")


def text_by_heading(kind):
    """Text by heading; what comes before the first is under an empty one."""
    parts = re.split(r"^## (.*)$", page_text(kind), flags=re.MULTILINE)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


@every_law
def test_page_has_all_sections(kind):
    found = text_by_heading(kind)
    assert list(found) == ["", *SECTIONS]
    assert re.match(rf"# {kind.__name__}: .*\n\n\S", found[""])
    assert all(text.strip() for text in found.values())
    assert page_text(kind).count(f"\n::: tarc.laws.{kind.__name__}\n") == 1


@every_law
def test_page_tells_how_to_choose_each_parameter_of_the_law(kind):
    advice = text_by_heading(kind)["Choosing its parameters"]
    own = set(inspect.get_annotations(kind)) & {one.name for one in fields(kind)}
    missing = {name for name in own if f"`{name}`" not in advice}
    assert not missing


@every_law
def test_page_has_the_equation_of_the_docstring(kind):
    assert f"<!-- begin equation -->\n\n{equation(kind)}\n\n<!-- end equation -->" in page_text(kind), (
        "run python -m benchmarks.pages"
    )


@every_law
def test_page_has_its_figure(kind):
    figure = DOCS / "images" / "laws" / f"{kind.__name__}.png"
    assert f"](../images/laws/{figure.name})" in text_by_heading(kind)["In the benchmark"]
    assert figure.is_file()
    assert figure.stat().st_size < 60_000


@every_law
def test_page_shows_the_gains_that_are_shipped(kind):
    shipped = {name: rounded(law) for name, law in tuned_laws().items() if law["kind"] == kind.__name__}
    block = re.search(r"```yaml\n(.*?)```", text_by_heading(kind)["In the benchmark"], re.DOTALL)
    assert block, "run make compare, and python -m benchmarks.pages"
    shown = {law.pop("label"): law for law in read_yaml(block[1], kind.__name__)["law"]}
    assert {name: shown.get(name) for name in shipped} == shipped, "run make compare, and python -m benchmarks.pages"


@every_law
@pytest.mark.parametrize("place", ["explanation/laws.md", "reference/laws.md", "../mkdocs.yml"])
def test_page_is_found(kind, place):
    assert f"laws/{kind.__name__}.md" in (DOCS / place).read_text(encoding="utf-8")


def test_no_page_without_a_law():
    pages = {path.stem for path in (DOCS / "laws").glob("*.md")}
    assert pages == {kind.__name__ for kind in concrete_laws()}
