"""The Live tab in a browser: a loop on a simulated robot, whose gains change within what is certified."""

from collections.abc import Iterator
from typing import Any

import pytest

pytestmark = pytest.mark.slow

READY = 250_000
"""Longest wait for certificates on a loaded machine [ms]."""


@pytest.fixture
def page(browser: Any, server: str) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.set_default_timeout(READY)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{server}?law=TDC")
    page.wait_for_function("() => window.did_handshake")
    page.get_by_role("tab", name="Live").click()
    yield page
    context.close()
    assert not errors


def error_shown(page: Any) -> str:
    """Return the error that the page shows."""
    return page.locator(".live-numbers > div").nth(2).locator("dd").inner_text()


def test_a_gain_changes_while_the_loop_runs_and_only_within_its_range(page: Any) -> None:
    page.get_by_role("button", name="Start").click()
    slider = page.get_by_label("Natural frequency [rad/s] while it runs", exact=True)
    slider.wait_for()
    assert slider.is_enabled()
    page.wait_for_function("() => /^track/.test(document.querySelector('.live-numbers').textContent.split('phase')[1])")
    errors = set()
    for _ in range(100):
        errors.add(error_shown(page))
        if len(errors) > 3:
            break
        page.wait_for_timeout(100)
    assert len(errors) > 3
    assert all(float(text) >= 0 for text in errors if text != "–")
    note = page.get_by_text("running with")
    assert "natural frequency 15" in note.inner_text()

    slider.fill(str(int(slider.get_attribute("max")) - 2))
    page.wait_for_function("() => /running with natural frequency (?!15)/.test(document.body.textContent)")
    field = page.get_by_label("Natural frequency [rad/s] while it runs, exact value")
    changed = float(field.input_value())
    assert changed != 15.0

    field.fill("90")
    field.press("Enter")
    refusal = page.get_by_role("alert").filter(has_text="got 90")
    refusal.wait_for()
    assert "certified with the other gains as they are: one of" in refusal.inner_text()
    assert "stop and certify another law" in refusal.inner_text()

    assert float(field.input_value()) == changed

    page.get_by_role("button", name="Stop").click()
    page.get_by_text("stopped on request; ").wait_for()
    assert not slider.is_enabled()
