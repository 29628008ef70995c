"""Widgets of the documentation: their data are those of the package, and they work without a server."""

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tarc
from benchmarks import widgets

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("estimators", "laws", "certificates")


def stored() -> dict[str, Any]:
    """Return the data in the documentation."""
    text = widgets.TARGET.read_text(encoding="utf-8")
    return json.loads(text.split("=", 1)[1].rstrip().rstrip(";"))


@pytest.mark.slow
def test_data_are_those_of_the_package() -> None:
    data = stored()
    assert data["estimators"]["10/2/1"] == widgets.estimator(10, 2, 1)
    number = 8
    frequency = widgets.NATURAL_FREQUENCIES[number]
    law = tarc.laws.TDC(
        inertia=1.0,
        natural_frequency=float(frequency),
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
    )
    ends = [data["maps"]["10/0"][end][number] for end in ("low", "high")]
    assert np.allclose(ends, tarc.analysis.stable_interval(law), rtol=1e-3)


def test_errors_decay_inside_the_stable_interval_alone() -> None:
    """A second route to the ends: simulated errors against eigenvalues."""
    data = stored()
    for name, found in data["responses"].items():
        low, high = found["interval"]
        for ratio, errors in zip(data["ratios"], found["errors"], strict=True):
            if ratio > 1.5 * high:
                assert None in errors or abs(errors[-1]) > 0.02, (name, ratio)
            if 3 * low < ratio < 0.8 * high:
                assert None not in errors, (name, ratio)
                assert abs(errors[-1]) < 0.1, (name, ratio)


def test_every_widget_of_a_page_is_known() -> None:
    script = (DOCS / "assets" / "widgets.js").read_text(encoding="utf-8")
    known = re.search(r"const builders = \{(.*?)\}", script)
    assert known
    names = {part.split(":")[0].strip() for part in known[1].split(",")}
    used = {
        name
        for page in PAGES
        for name in re.findall(r'data-widget="(\w+)"', (DOCS / "explanation" / f"{page}.md").read_text("utf-8"))
    }
    assert used == names


@pytest.mark.slow
def test_widgets_follow_their_sliders_without_a_server(tmp_path: Path) -> None:
    chromium = shutil.which("chromium")
    if chromium is None:
        assert not os.environ.get("TARC_REQUIRE_BROWSER"), "needs chromium: TARC_REQUIRE_BROWSER is set"
        pytest.skip("needs chromium")
    from playwright.sync_api import sync_playwright

    for name in ("widgets.js", "widget-data.js"):
        shutil.copy(DOCS / "assets" / name, tmp_path / name)
    hosts = "".join(
        f'<div class="tarc-widget" data-widget="{name}"></div>' for name in ("kernel", "window", "ratio", "map")
    )
    page_text = (
        f'<!DOCTYPE html><html lang="en"><title>x</title><body>{hosts}<script src="widgets.js"></script></body></html>'
    )
    (tmp_path / "page.html").write_text(page_text, encoding="utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_selector(".tarc-widget svg path", state="attached")
        last = page.locator(".tarc-widget").last
        assert "stable" in last.locator("p").inner_text()
        last.get_by_label("Inertia ratio", exact=True).fill("20")
        assert ": unstable" in last.locator("p").inner_text()
        for slider in page.locator(".tarc-widget input").all():
            before = slider.evaluate("input => input.closest('.tarc-widget').querySelector('p').textContent")
            slider.press("ArrowRight")
            slider.press("ArrowLeft")
            assert slider.evaluate("input => input.closest('.tarc-widget').querySelector('p').textContent") == before
        browser.close()
    assert not errors
