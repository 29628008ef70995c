"""The page of `tarc studio` under load: start, memory, latency with ten users of whom nine are idle, a seeded monkey.

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
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np

ARGUMENTS = ("--no-sandbox", "--disable-3d-apis")
"""Of chromium: without a graphics card it would draw the robots of ten pages on the processor that is measured."""
FREQUENCY = "Natural frequency [rad/s]"
SLIDERS = (FREQUENCY, "Damping ratio", "Inertia share", "Window [periods]", "Payload [kg]")
PRESETS = ("Calm", "Balanced", "Stiff", "Adaptive", "Too eager")
ACTIONS = {
    "slide": 120,
    "preset": 16,
    "undo": 16,
    "redo": 12,
    "click": 20,
    "drag": 6,
    "check": 6,
    "choose": 4,
    "tab": 2,
    "reload": 1,
}
"""What a monkey does, with how often."""
PAUSES = (0, 10, 30)
"""Times between two actions of a monkey [ms]."""
READY = 120_000
"""Longest wait for the page [ms]."""
BLOCKED = 3_000
"""Longest wait of a monkey for what it clicks, which a menu may cover [ms]."""
RELOADED = "Execution context was destroyed"
"""What Playwright says where the page loads itself again meanwhile, as after a lost connection."""
EXIT_TIME = 2
"""Longest wait for the exit code of a server that does not answer [s]."""
USERS = 10
SAMPLES = 40
"""Measurements of the memory over the actions of a monkey."""
MOVE = """
([label, target]) => new Promise((resolve) => {
  const input = [...document.querySelectorAll("input[type=range]")].find((one) => one.ariaLabel === label);
  const start = performance.now();
  const end = (value) => { observer.disconnect(); resolve(value); };
  const observer = new MutationObserver(() => end(performance.now() - start));
  observer.observe(document.querySelector(target), { childList: true, subtree: true, characterData: true });
  setTimeout(() => end(null), 60000);
  const next = +input.value + 0.02;
  input.value = next < 0.9 || next > 1.04 ? 0.9 : next;
  input.dispatchEvent(new Event("input", { bubbles: true }));
})
"""
"""Moves the natural frequency, 8 to 11 rad/s, and returns the time until a part of the page changes [ms]."""
SLIDE = """
(input, share) => {
  input.value = +input.min + share * (input.max - input.min);
  input.dispatchEvent(new Event("input", { bubbles: true }));
}
"""
"""Moves a slider."""
REFRESHES = """
(seconds) => new Promise((resolve) => {
  let count = 0;
  const observer = new MutationObserver(() => { count += 1; });
  const time = document.querySelector(".live-numbers dd");
  observer.observe(time, { childList: true, subtree: true, characterData: true });
  setTimeout(() => { observer.disconnect(); resolve(count / seconds); }, 1000 * seconds);
})
"""
"""Returns how often per second the time of a loop changes in the Live tab."""
REFRESH_TIME = 10
"""Time in which these changes are counted [s]."""
QUIET = "() => document.querySelector('.certificate') && !document.querySelector('.certificates.stale')"
"""Whether the certificates of the present design are there, the last that a move computes."""


@dataclass
class Server:
    """A server of the page, its process and its log."""

    url: str
    process: subprocess.Popen
    log: Path
    start_time: float
    start_cpu: float

    def memory(self) -> float:
        """Return the memory of the server and of the processes that it started [MB].

        Pages that processes share count once (proportional set size).
        """
        return sum(_proportional(pid) for pid in self._pids())

    def cpu(self) -> dict[int, float]:
        """Return the processor time of the server and of each process that it started [s]."""
        times = {}
        for pid in self._pids():
            with suppress(OSError):  # one that has ended meanwhile
                times[pid] = processor_time(pid)
        return times

    def _pids(self) -> list[int]:
        pids = [self.process.pid]
        for pid in pids:
            for children in Path(f"/proc/{pid}/task").glob("*/children"):
                with suppress(OSError):
                    pids += [int(child) for child in children.read_text().split()]
        return pids

    def failures(self) -> int:
        """Return how many exceptions and crashes the server and its processes have printed."""
        text = self.log.read_text(encoding="utf-8")
        return text.count("Traceback") + text.count("Fatal Python error")

    def print_log(self) -> None:
        """Print the log, with the exit code of a server that has ended."""
        try:
            state = f"ended with code {self.process.wait(EXIT_TIME)}"
        except subprocess.TimeoutExpired:
            state = "still runs"
        print(f"the server {state}; its log:\n{self.log.read_text(encoding='utf-8')}", flush=True)


@dataclass
class Report:
    """What a monkey found: errors of the page, actions that were blocked, and memory of the server [MB]."""

    actions: int = 0
    errors: list[str] = field(default_factory=list)
    blocked: int = 0
    memory: list[float] = field(default_factory=list)


def processor_time(pid: int) -> float:
    """Return the processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _proportional(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


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
                    time.sleep(0.02)
            server = Server(url, process, log, time.perf_counter() - started, processor_time(process.pid))
            try:
                yield server
            except Exception:
                server.print_log()
                raise
            if server.failures():
                server.print_log()
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
    page.set_default_timeout(READY)
    page.goto(url)
    page.wait_for_selector(".measures .head", timeout=READY)
    return page


def latencies(
    page: Any, target: str, moves: int, pause: int = 600, is_quiet: bool = False, busy: Any = None
) -> list[float]:
    """Return the times from moves of a slider to a change of a part of the page [s]; infinite for none.

    Parameters
    ----------
    page
        An open page.
    target
        Selector of the part.
    moves
        Number of moves.
    pause
        Between them [ms].
    is_quiet
        Whether each move waits for the certificates of the one before instead.
    busy
        A page of another user, who moves as well; None for none.
    """
    times = []
    for _ in range(moves):
        if busy is not None:
            _slide(busy, FREQUENCY, random.random())
        if is_quiet:
            page.wait_for_function(QUIET, timeout=READY)
        else:
            page.wait_for_timeout(pause)
        found = page.evaluate(MOVE, [FREQUENCY, target])
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
    from playwright.sync_api import Error
    from playwright.sync_api import TimeoutError as BlockedError

    rng = random.Random(seed)
    report = Report(actions)
    page.on("pageerror", lambda error: report.errors.append(str(error)))
    page.set_default_timeout(BLOCKED)
    for number in range(actions):
        try:
            _act(page, rng)
        except Error as error:
            if not isinstance(error, BlockedError) and RELOADED not in str(error):
                raise
            report.blocked += 1
            page.keyboard.press("Escape")
        page.wait_for_timeout(rng.choice(PAUSES))
        if number % max(actions // SAMPLES, 1) == 0:
            report.memory.append(server.memory())
            print(f"action {number}: {report.memory[-1]:.0f} MB, {report.blocked} blocked", flush=True)
    page.set_default_timeout(READY)
    page.get_by_role("tab", name="Design").click()
    page.wait_for_function(QUIET, timeout=READY)
    report.memory.append(server.memory())
    return report


def _act(page: Any, rng: random.Random) -> None:
    """Do one random thing."""
    kind = rng.choices(list(ACTIONS), list(ACTIONS.values()))[0]
    if kind == "slide":
        _slide(page, rng.choice(SLIDERS), rng.random())
    elif kind == "preset":
        page.get_by_role("button", name=rng.choice(PRESETS), exact=True).click()
    elif kind in ("undo", "redo"):
        page.keyboard.press("Control+z" if kind == "undo" else "Control+y")
    elif kind == "check":
        page.get_by_text(rng.choice(("Synchronised", "Model known, M̂(q)"))).click()
    elif kind == "click":
        page.mouse.click(rng.uniform(320, 1270), rng.uniform(60, 890))
    elif kind == "drag":
        _drag(page, rng)
    elif kind == "choose":
        page.get_by_label(rng.choice(("Law", "Rival", "Robot")), exact=True).first.press("ArrowDown")
        page.keyboard.press(rng.choice(("Enter", "Escape")))
    elif kind == "tab":
        page.get_by_role("tab", name=rng.choice(("Study", "Live"))).click()
        page.get_by_role("tab", name="Design").click()
    else:
        page.reload(timeout=READY)
        page.wait_for_selector(".control-row", timeout=READY)


def _slide(page: Any, label: str, share: float) -> None:
    """Move a slider to a share of its length, once it is there."""
    page.locator(f'input[type=range][aria-label="{label}"]').evaluate(SLIDE, share)


def _drag(page: Any, rng: random.Random) -> None:
    """Drag the dot of the map, if it is there."""
    place = page.evaluate(
        """() => {
          const box = document.querySelector(".map .shapelayer path")?.getBoundingClientRect();
          return box && [box.x + box.width / 2, box.y + box.height / 2];
        }"""
    )
    if place is None:
        return
    page.mouse.move(*place)
    page.mouse.down()
    page.mouse.move(place[0] + rng.uniform(-80, 80), place[1] + rng.uniform(-80, 80), steps=rng.randrange(1, 8))
    page.mouse.up()


def report_latencies(
    server: Server, page: Any, label: str, measures: dict[str, tuple[str, int, bool]], busy: Any = None
) -> None:
    """Print the latencies of a page, by name: the part that changes, the number of moves, and whether they wait.

    The processor time is that of all processes that live on, so without those of the certificates.
    """
    for name, (target, moves, is_quiet) in measures.items():
        cpu = server.cpu()
        times = latencies(page, target, moves, is_quiet=is_quiet, busy=busy)
        spent = sum(time - cpu[pid] for pid, time in server.cpu().items() if pid in cpu) / moves
        print(
            f"{label}, {name}: median {np.median(times):.3f} s, 95 % {np.quantile(times, 0.95):.3f} s, "
            f"largest {max(times):.3f} s of {moves}; processor time of the server {spent:.3f} s a move",
            flush=True,
        )


def report_refreshes(page: Any) -> None:
    """Start a loop on a simulated robot in the Live tab, and print how often the page shows it."""
    page.get_by_role("tab", name="Live").click()
    page.get_by_role("button", name="Start").click()
    page.wait_for_function("() => /track/.test(document.querySelector('.live-numbers').textContent)", timeout=READY)
    print(f"Live tab: {page.evaluate(REFRESHES, REFRESH_TIME):.1f} refreshes per second", flush=True)
    page.get_by_role("button", name="Stop").click()
    page.get_by_text("stopped on request").wait_for(timeout=READY)
    page.get_by_role("tab", name="Design").click()


def report_all_latencies(server: Server, pages: list[Any], moves: int) -> None:
    """Print the latencies of the first page, while the others are idle, and while the second is not."""
    few = max(moves // 7, 1)
    fast = {"map, stable range and noise": (".numbers", moves, False)}
    runs = {"runs": (".measures", moves, True), "certificates": (".certificates", few, True)}
    known = {"certificates with M̂(q)": (".certificates", few, True)}
    report_latencies(server, pages[0], "two-link arm", fast | runs)
    for query, label, measures in (
        ("?robot=ur5e", "UR5e", fast | runs),
        ("?robot=ur5e&model_known=True", "UR5e", known),
        ("?robot=panda_multisine&model_known=True", "Panda", known),
    ):
        pages[0].goto(server.url + query)
        pages[0].wait_for_selector(".measures .head", timeout=READY)
        report_latencies(server, pages[0], label, measures)
    pages[0].goto(server.url)
    pages[0].wait_for_selector(".measures .head", timeout=READY)
    pages[1].goto(server.url + "?robot=panda_multisine&model_known=True")
    pages[1].wait_for_selector(".measures .head", timeout=READY)
    label = "two-link arm while another user moves a Panda with M̂(q)"
    report_latencies(server, pages[0], label, fast, busy=pages[1])
    pages[1].goto(server.url)
    pages[1].wait_for_selector(".measures .head", timeout=READY)


def main() -> None:
    """Print the measures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", type=int, default=300, help="actions of the monkey")
    parser.add_argument("--moves", type=int, default=20, help="moves whose latency is measured; 0 for none")
    options = parser.parse_args()
    started = time.perf_counter()
    with serving() as server, browsing() as browser:
        print(f"first page served after {server.start_time:.1f} s, processor time {server.start_cpu:.2f} s")
        pages = [open_page(browser, server.url)]
        pages[0].wait_for_function(QUIET, timeout=READY)
        first = server.memory()
        pages += [open_page(browser, server.url) for _ in range(USERS - 1)]
        for page in pages:
            page.wait_for_function(QUIET, timeout=READY)
        each = (server.memory() - first) / (USERS - 1)
        print(f"memory, shared pages counted once: {first:.0f} MB with one user, {each:.1f} MB for each further one")
        if options.moves:
            report_all_latencies(server, pages, options.moves)
            report_refreshes(pages[0])
            print(f"up to here {time.perf_counter() - started:.0f} s", flush=True)
        report = monkey(pages[0], server, options.actions)
        quarter = len(report.memory) // 4
        early, late = np.mean(report.memory[quarter : 2 * quarter]), np.mean(report.memory[-quarter:])
        print(
            f"monkey: {report.actions} actions, {report.blocked} of them blocked by a menu, "
            f"{len(report.errors)} errors of the page, {server.failures()} exceptions and crashes of the server"
        )
        print(
            f"memory over the second and last quarter of its actions: {early:.0f} and {late:.0f} MB, largest "
            f"{max(report.memory):.0f} MB, at its end {report.memory[-1]:.0f} MB"
        )
        print("\n".join(sorted(set(report.errors))))
    print(f"in all {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
