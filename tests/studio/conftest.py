"""A server of the page in a process of its own, and Debian's chromium, which Playwright's library drives."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import pytest

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)


def free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Start `tarc studio`; return its URL, and end it."""
    port = free_port()
    folder = tmp_path_factory.mktemp("server")
    log = folder / "log.txt"
    source = str(Path(__file__).parents[2] / "src")
    # NiceGUI behaves otherwise where it sees a test around it
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    environment = {**inherited, "PYTHONPATH": source, "TMPDIR": str(folder)}
    with log.open("w") as out:
        command = [sys.executable, "-m", "tarc", "studio", "--no-open", "--port", str(port)]
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, env=environment, cwd=folder)
    url = f"http://127.0.0.1:{port}"
    try:
        for _ in range(1800):
            assert process.poll() is None, log.read_text()
            try:
                urlopen(url, timeout=5).close()
                break
            except (URLError, TimeoutError):
                time.sleep(0.1)
        yield url
        # CasADi fails where two threads use it, so that the server leaves it to processes of one thread
        maps = Path(f"/proc/{process.pid}/maps")
        assert not maps.exists() or "casadi" not in maps.read_text()
    finally:
        process.terminate()
        process.wait(30)
    text = log.read_text()
    assert "Traceback" not in text, text
    left = [path.name for path in folder.iterdir() if path.name.startswith("tarc-studio-")]
    assert not left, "folders of sessions are left"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Start chromium; skip without it, and fail where TARC_REQUIRE_BROWSER says that it must be there."""
    path = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if path is None:
        message = f"needs a browser: one of {', '.join(CHROMIUM)}"
        if os.environ.get("TARC_REQUIRE_BROWSER"):
            pytest.fail(f"{message}: TARC_REQUIRE_BROWSER is set")
        pytest.skip(message)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        yield chromium
        chromium.close()
