"""Docstrings and pages are read once: short sentences, plain words."""

from pathlib import Path

import pytest

from meta.prose_rules import page_problems, sentences, source_problems, words

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "src" / "tarc").rglob("*.py"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_words_are_counted_without_code_and_formulas():
    assert words("The gain `law.max_gain` stays below ‖E − ρ0 I‖ ≤ δ.") == 5
    assert sentences("It grows, e.g. by noise. Give a limit.") == ["It grows, e.g by noise.", "Give a limit."]


@pytest.mark.parametrize("module", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_docstrings(module):
    problems = source_problems(module)
    assert not problems, "\n".join(map(str, problems))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_pages(page):
    problems = page_problems(page)
    assert not problems, "\n".join(map(str, problems))
