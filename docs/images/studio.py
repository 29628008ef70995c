"""Take the pictures of the Studio in a browser: ``docs/images/studio.py``."""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

from make import IMAGES, shrink
from playwright.sync_api import Browser, sync_playwright

PORT = 8765
URL = f"http://127.0.0.1:{PORT}"
DESIGN = (
    "robot=ur5e&law=TARC&rival=TDC&natural_frequency=20&max_gain=6.4"
    "&encoder_bits=17&payload=5&inertia_share=0.06"
)
STUDIED = "natural_frequency=25&inertia_share=0.1&payload=4"
PATIENCE = 120_000
ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


def wait_for_server() -> None:
    """Wait until the page answers."""
    for _ in range(200):
        try:
            urlopen(URL, timeout=5).close()
            return
        except (URLError, TimeoutError):
            time.sleep(0.2)


def take_design(browser: Browser, target: Path) -> None:
    """Take the Design tab in the light theme."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(f"{URL}/?{DESIGN}")
    page.wait_for_selector(".certificate", timeout=PATIENCE)
    page.wait_for_timeout(8000)
    page.screenshot(path=target, full_page=True)


def take_study(browser: Browser, target: Path) -> None:
    """Take the Study tab in the dark theme after a thousand draws."""
    page = browser.new_page(
        viewport={"width": 1280, "height": 760}, color_scheme="dark"
    )
    page.goto(f"{URL}/?{STUDIED}")
    page.wait_for_selector(".certificate", timeout=PATIENCE)
    page.get_by_role("tab", name="Study").click()
    page.get_by_role("button", name="Run study").click()
    page.get_by_text("1000 of 1000 runs").wait_for(timeout=PATIENCE)
    page.get_by_label("Number of the run to replay").fill("7")
    page.wait_for_timeout(1000)
    page.get_by_role("button", name="Replay").click()
    page.get_by_text("Run 7:").wait_for(timeout=PATIENCE)
    page.wait_for_timeout(4000)
    page.screenshot(path=target)


def take_live(browser: Browser, target: Path) -> None:
    """Take the Live tab in the light theme, with a gain that was refused."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(PATIENCE)
    page.goto(f"{URL}/?law=TARC")
    page.wait_for_selector(".certificate")
    page.get_by_role("tab", name="Live").click()
    page.get_by_role("button", name="Start").click()
    name = "Natural frequency [rad/s] while it runs, exact value"
    page.get_by_label(name).wait_for()
    page.wait_for_timeout(6000)
    page.get_by_label(name).fill("90")
    page.get_by_label(name).press("Enter")
    page.get_by_role("alert").filter(has_text="got 90").wait_for()
    page.wait_for_timeout(1000)
    page.screenshot(path=target, full_page=True)
    page.get_by_role("button", name="Stop").click()
    page.get_by_text("stopped on request").wait_for()


def main() -> None:
    """Start the Studio and take the pictures."""
    command = [sys.executable, "-m", "tarc", "studio", "--no-open"]
    server = subprocess.Popen([*command, "--port", str(PORT)])
    try:
        wait_for_server()
        with (
            tempfile.TemporaryDirectory() as folder,
            sync_playwright() as playwright,
        ):
            chromium = shutil.which("chromium")
            browser = playwright.chromium.launch(
                executable_path=chromium, args=ARGUMENTS
            )
            for name, take in (
                ("studio-design.png", take_design),
                ("studio-study.png", take_study),
                ("studio-live.png", take_live),
            ):
                take(browser, Path(folder) / name)
                shrink(Path(folder) / name, IMAGES / name)
            browser.close()
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
