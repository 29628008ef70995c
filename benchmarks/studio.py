"""The page of `tarc studio` under load: start, latency with ten users, memory, and a seeded monkey.

Run `python -m benchmarks.studio`, or `python -m benchmarks.studio --actions 5000` for the long monkey. Chromium and the
server share the machine, so the times are upper bounds.
"""

import argparse
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np

ARGUMENTS = ("--no-sandbox", "--disable-3d-apis")
"""Of chromium: without a graphics card it would draw the robots of ten pages on the processor that is measured."""
SLIDERS = ("Natural frequency [rad/s]", "Damping ratio", "Inertia share", "Window [periods]", "Payload [kg]")
PRESETS = ("Calm", "Balanced", "Stiff", "Adaptive", "Too eager")
ACTIONS = {"slide": 60, "preset": 8, "undo": 8, "redo": 6, "check": 3, "click": 10, "law": 2, "reload": 1}
"""What a monkey does, with how often."""
READY = 120_000
"""Longest wait for the page [ms]."""
MOVE = """
([label, position, target]) => new Promise((resolve) => {
  const input = [...document.querySelectorAll("input[type=range]")].find((one) => one.ariaLabel === label);
  const start = performance.now();
  const end = (value) => { observer.disconnect(); resolve(value); };
  const observer = new MutationObserver(() => end(performance.now() - start));
  observer.observe(document.querySelector(target), { childList: true, subtree: true, characterData: true });
  setTimeout(() => end(null), 20000);
  input.value = position;
  input.dispatchEvent(new Event("input", { bubbles: true }));
})
"""
"""Moves a slider and returns the time until a part of the page changes [ms]."""


@dataclass
class Server:
    """A server of the page, its process and its log."""

    url: str
    process: subprocess.Popen
    log: Path
    start_time: float

    def memory(self) -> float:
        """Return the resident memory of the server and of the processes that it started [MB]."""
        pids = [self.process.pid]
        for pid in pids:
            children = Path(f"/proc/{pid}/task/{pid}/children")
            pids += [int(child) for child in children.read_text().split()] if children.exists() else []
        return sum(_resident(pid) for pid in pids)

    def tracebacks(self) -> int:
        """Return how many exceptions the server has printed."""
        return self.log.read_text(encoding="utf-8").count("Traceback")


@dataclass
class Report:
    """What a monkey found: errors of the page, and memory of the server over the actions [MB]."""

    actions: int = 0
    errors: list[str] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)


def _resident(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


@contextmanager
def serving() -> Iterator[Server]:
    """Start the server in a process of its own, and end it."""
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        port = trial.getsockname()[1]
    # NiceGUI behaves otherwise where it sees a test around it
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.txt"
        started = time.perf_counter()
        with log.open("w") as out:
            command = [sys.executable, "-m", "tarc", "studio", "--no-open", "--port", str(port)]
            process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, env=environment, cwd=folder)
        url = f"http://127.0.0.1:{port}"
        try:
            while True:
                try:
                    urlopen(url, timeout=5).close()
                    break
                except (URLError, TimeoutError):
                    if process.poll() is not None:
                        raise SystemExit(log.read_text()) from None
                    time.sleep(0.05)
            yield Server(url, process, log, time.perf_counter() - started)
        finally:
            process.terminate()
            process.wait(30)


@contextmanager
def browsing() -> Iterator[Any]:
    """Start chromium."""
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        yield browser
        browser.close()


def open_page(browser: Any, url: str) -> Any:
    """Open the page and wait for its first run."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(url)
    page.wait_for_selector(".measures .head", timeout=READY)
    return page


def latencies(page: Any, target: str, moves: int) -> list[float]:
    """Return the times from moves of a slider to a change of a part of the page [s]; infinite for none."""
    times = []
    for number in range(moves):
        page.wait_for_timeout(600)
        position = 0.9 + 0.02 * (number % 7)
        found = page.evaluate(MOVE, ["Natural frequency [rad/s]", position, target])
        times.append(np.inf if found is None else found / 1000)
    return times


def monkey(page: Any, server: Server, actions: int, seed: int = 1) -> Report:
    """Do random things on the page.

    Parameters
    ----------
    page
        An open page.
    server
        Its server.
    actions
        Number of things to do.
    seed
        Of the random numbers.
    """
    rng = random.Random(seed)
    report = Report(actions)
    page.on("pageerror", lambda error: report.errors.append(str(error)))
    for number in range(actions):
        _act(page, rng)
        page.wait_for_timeout(rng.choice((0, 20, 100)))
        if number % max(actions // 20, 1) == 0:
            report.memory.append(server.memory())
    page.wait_for_selector(".certificate", timeout=READY)
    report.memory.append(server.memory())
    return report


def _act(page: Any, rng: random.Random) -> None:
    """Do one random thing."""
    kind = rng.choices(
        ("slide", "preset", "undo", "redo", "check", "click", "law", "reload"), (60, 8, 8, 6, 3, 10, 2, 1)
    )[0]
    if kind == "slide":
        field = page.get_by_label(rng.choice(SLIDERS), exact=True).first
        low, high = (float(field.get_attribute(end) or 0) for end in ("min", "max"))
        field.evaluate(
            "(input, value) => { input.value = value; input.dispatchEvent(new Event('input', { bubbles: true })); }",
            f"{rng.uniform(low, high):.3f}",
        )
    elif kind == "preset":
        page.get_by_role("button", name=rng.choice(PRESETS), exact=True).click()
    elif kind in ("undo", "redo"):
        page.keyboard.press("Control+z" if kind == "undo" else "Control+y")
    elif kind == "check":
        page.get_by_text("Synchronised").click()
    elif kind == "click":
        page.mouse.click(rng.uniform(320, 1270), rng.uniform(60, 890))
    elif kind == "law":
        page.get_by_label("Law", exact=True).first.press("ArrowDown")
        page.keyboard.press("Escape")
    else:
        page.reload()
        page.wait_for_selector(".control-row", timeout=READY)


def main() -> None:
    """Print the measures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", type=int, default=300, help="actions of the monkey")
    parser.add_argument("--moves", type=int, default=30, help="moves whose latency is measured")
    options = parser.parse_args()
    with serving() as server, browsing() as browser:
        print(f"first page served after {server.start_time:.1f} s")
        pages = [open_page(browser, server.url)]
        first = server.memory()
        pages += [open_page(browser, server.url) for _ in range(9)]
        print(f"memory: {first:.0f} MB with one user, {(server.memory() - first) / 9:.0f} MB for each further one")
        for name, target in (("map, stable range and noise", ".numbers"), ("runs", ".measures")):
            times = latencies(pages[0], target, options.moves)
            print(f"{name}, nine idle users: median {np.median(times):.3f} s, 95 % {np.quantile(times, 0.95):.3f} s")
        report = monkey(pages[0], server, options.actions)
        quarter = len(report.memory) // 4
        early, late = np.mean(report.memory[quarter : 2 * quarter]), np.mean(report.memory[-quarter:])
        print(f"monkey: {report.actions} actions, {len(report.errors)} errors, {server.tracebacks()} tracebacks")
        print(f"memory over its second and last quarter: {early:.0f} and {late:.0f} MB")
        print("\n".join(sorted(set(report.errors))))


if __name__ == "__main__":
    main()
