"""The page in a browser: what a user does, sees, hears from a screen reader, and what leaves the machine."""

import math
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe

import urdf_text

pytestmark = pytest.mark.slow

READY = 150_000
"""Longest wait for certificates on a loaded machine [ms]."""

PANES = {"Design": "Loop and certificates", "Study": "Replayed run", "Live": "Measurements"}
"""A pane of each tab."""
INSIDE = """(pane) => {
  const width = document.documentElement.clientWidth;
  const isShown = document.querySelector(`.pane[aria-label="${pane}"]`)?.checkVisibility();
  return isShown && document.documentElement.scrollWidth <= width
    && !document.querySelector("[class*=q-transition]")
    && [...document.querySelectorAll(".pane")].every((pane) => pane.getBoundingClientRect().right <= width);
}"""
"""Whether a pane is there and nothing is cut off."""


class Window:
    """A window of the page, with the addresses that it loaded and the errors that it threw."""

    def __init__(self, browser: Any, url: str, **options: Any) -> None:
        self.context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        self.page = self.context.new_page()
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.requests.append(socket.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(url)
        self.wait_for_verdict("certified|refuted|inconclusive")

    def wait_for_verdict(self, pattern: str) -> None:
        """Wait until the verdict for the robot is one of a pattern."""
        self.page.wait_for_function(
            """pattern => {
              const row = [...document.querySelectorAll(".certificate")].find(
                (element) => element.querySelector(".name")?.textContent === "Robot");
              return row && !row.closest(".stale")
                && new RegExp(`^(${pattern})$`).test(row.querySelector(".verdict").textContent.trim());
            }""",
            arg=pattern,
            timeout=READY,
        )

    def slide(self, label: str, position: float) -> None:
        """Move a slider."""
        self.page.get_by_label(label, exact=True).first.fill(str(position))

    def query(self, name: str) -> float:
        """Return a number of the design in the URL."""
        pairs = dict(pair.split("=") for pair in urlsplit(self.page.url).query.split("&") if pair)
        return float(pairs[name])


@pytest.fixture
def window(browser: Any, server: str) -> Iterator[Window]:
    result = Window(browser, server)
    yield result
    result.context.close()


def test_moving_a_slider_changes_the_verdict_and_reloading_keeps_the_design(window: Window) -> None:
    window.wait_for_verdict("certified")
    window.slide("Inertia share", 0.0)
    window.wait_for_verdict("refuted")
    assert window.query("inertia_share") == pytest.approx(1.0, rel=0.01)
    window.page.reload()
    window.wait_for_verdict("refuted")
    assert window.query("inertia_share") == pytest.approx(1.0, rel=0.01)
    assert not window.errors


def test_undo_and_redo_by_keyboard(window: Window) -> None:
    window.slide("Inertia share", 0.0)
    window.wait_for_verdict("refuted")
    window.page.locator("body").click(position={"x": 640, "y": 20})
    window.page.keyboard.press("Control+z")
    window.wait_for_verdict("certified")
    window.page.keyboard.press("Control+y")
    window.wait_for_verdict("refuted")


def test_dragging_the_dot_moves_the_sliders(window: Window) -> None:
    """The sliders and the numbers of the loop follow while the dot is held, and the dot stays under the pointer."""
    page, mouse = window.page, window.page.mouse
    dot = page.locator(".map .shapelayer path").first.bounding_box()
    x, y = dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2
    before = page.locator(".numbers").inner_text()
    assert "unstable" not in before
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 20, y - 60, steps=4)
    page.wait_for_function("() => document.querySelector('.numbers').textContent.includes('unstable')", timeout=READY)
    mouse.move(x + 40, y - 120, steps=4)
    page.wait_for_function("() => parseFloat(new URLSearchParams(location.search).get('inertia_share')) > 0.3")
    assert float(page.get_by_label("Inertia share", exact=True).first.input_value()) > math.log10(0.3)
    page.wait_for_function(
        """([x, y]) => {
          const box = document.querySelector(".map .shapelayer path")?.getBoundingClientRect();
          return box && Math.hypot(box.x + box.width / 2 - x, box.y + box.height / 2 - y) < 2;
        }""",
        arg=[x + 40, y - 120],
    )
    mouse.up()
    window.wait_for_verdict("refuted")
    assert window.query("natural_frequency") > 16


def test_a_broken_robot_is_named_and_a_right_one_is_shown(window: Window) -> None:
    page = window.page
    page.get_by_text("Upload a robot").click()
    field = page.locator("input[type=file]")
    broken = {"name": "arm.urdf", "mimeType": "text/xml", "buffer": urdf_text.arm().encode()[:200]}
    field.set_input_files([broken])
    message = page.get_by_role("status").filter(has_text="arm.urdf")
    message.wait_for(timeout=READY)
    assert "is no XML file" in message.inner_text()
    attack = b'<!DOCTYPE a [<!ENTITY b "<i>c</i>">]><robot name="&b;"/>'
    field.set_input_files([{"name": "attack.urdf", "mimeType": "text/xml", "buffer": attack}])
    page.get_by_text("document type").wait_for(timeout=READY)
    right = {"name": "arm.urdf", "mimeType": "text/xml", "buffer": urdf_text.arm().encode()}
    field.set_input_files([right])
    page.get_by_role("status").filter(has_text="arm.urdf: 2 joints").wait_for(timeout=READY)
    page.get_by_text("arm (uploaded)").first.wait_for(timeout=READY)
    window.wait_for_verdict("certified|refuted|inconclusive")


def test_the_robot_plays_its_run(window: Window) -> None:
    """The scene takes its time from its slider, and moves the lines in the curves with it."""
    page = window.page
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for()
    page.wait_for_function("() => parseFloat(document.querySelector('.robot-scene-time').textContent) > 0.2")
    page.get_by_role("button", name="Pause").click()
    first = page.locator(".robot-scene canvas").screenshot()
    page.get_by_label("Time of the run").fill("2.5")
    page.wait_for_function("() => document.querySelector('.robot-scene-time').textContent === '2.50 s'")
    page.wait_for_timeout(300)
    assert page.locator(".robot-scene canvas").screenshot() != first
    places = page.eval_on_selector_all(".time-cursor", "lines => lines.map(line => line.style.transform)")
    assert len(places) >= 2
    assert all("translateX" in place for place in places)


def test_a_click_on_a_dot_of_the_cloud_replays_its_run(window: Window) -> None:
    page = window.page
    page.get_by_role("tab", name="Study").click()
    page.get_by_label("Number of runs").fill("8")
    page.get_by_role("button", name="Run study").click()
    page.get_by_text("8 of 8 runs").wait_for(timeout=READY)
    place = page.evaluate(
        """() => {
          const plot = document.querySelector(".cloud .js-plotly-plot, .cloud.js-plotly-plot");
          const { xaxis, yaxis, _size } = plot._fullLayout;
          const [dots] = plot.data;
          const box = plot.getBoundingClientRect();
          return { run: dots.customdata[3], x: box.x + _size.l + xaxis.d2p(dots.x[3]),
            y: box.y + _size.t + yaxis.d2p(dots.y[3]) };
        }"""
    )
    page.mouse.move(place["x"], place["y"])
    page.mouse.click(place["x"], place["y"])
    page.get_by_text(f"Run {place['run']}: design").wait_for(timeout=READY)
    assert page.get_by_label("Number of the run to replay").input_value() == str(place["run"])
    assert not window.errors


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_screen_readers_contrast_widths_and_requests(browser: Any, server: str, scheme: str) -> None:
    """No serious finding of axe-core on any tab, nothing cut off, no error, and no request to another computer."""
    window = Window(browser, server, color_scheme=scheme)
    findings = []
    for tab in ("Design", "Study", "Live"):
        window.page.get_by_role("tab", name=tab).click()
        for width in (1920, 1280):
            window.page.set_viewport_size({"width": width, "height": 1000})
            window.page.wait_for_function(INSIDE, arg=PANES[tab])  # the tab slides in
        findings += [
            (tab, rule["id"], [node["html"][:200] for node in rule["nodes"]])
            for rule in Axe().run(window.page).response["violations"]
            if rule["impact"] in ("serious", "critical")
        ]
    hosts = {urlsplit(url).netloc for url in window.requests if not url.startswith(("data:", "blob:"))}
    window.context.close()
    assert not findings
    assert hosts == {urlsplit(server).netloc}
    assert not window.errors
