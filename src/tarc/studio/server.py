"""Start the page on a port of this machine."""

import asyncio
import socket
import warnings
from pathlib import Path

from nicegui import app, ui

from tarc.core.allocator import limit_heaps, release_freed_memory
from tarc.core.errors import DesignWarning, InvalidParameter
from tarc.studio.access import Guard, SessionFolders, new_token
from tarc.studio.design_state import DesignState
from tarc.studio.jobs import start_first_process
from tarc.studio.page import add_pages
from tarc.studio.robots import Robots
from tarc.studio.worker import FACTS, LOOPS, RELEASE_PERIOD, RUNS

PORTS = range(8642, 8662)
"""Ports that are tried where none is given."""
HEAPS = 2
"""Heaps that the threads of the server share."""


def serve(scenario: str | Path | None, host: str = "127.0.0.1", port: int | None = None, show: bool = True) -> None:
    """Serve the page until it is stopped.

    Parameters
    ----------
    scenario
        A YAML file or the name of a shipped scenario to start from; None for a two-link arm.
    host, port
        Where to listen; None for a free port. On another address than this machine's own, the URL has a token.
    show
        Open a browser.

    Raises
    ------
    ScenarioError, InvalidParameter
        For a scenario that cannot be read, and a port that is taken.
    """
    limit_heaps(HEAPS)
    warnings.filterwarnings("ignore", category=DesignWarning)  # the page says it
    robots = Robots()
    state, notes = (DesignState(), []) if scenario is None else robots.add_scenario(scenario)
    chosen = free_port(host, port)
    token = new_token(host)
    folders = SessionFolders()
    app.add_middleware(Guard, token=token)
    for close in (FACTS.close, LOOPS.close, RUNS.close, folders.close):
        app.on_shutdown(close)
    app.on_startup(_prepare)
    app.timer(RELEASE_PERIOD, lambda: asyncio.to_thread(release_freed_memory))
    add_pages(robots, state, notes, folders)
    path = "/" if token is None else f"/?token={token}"
    app.on_startup(lambda: print(f"tarc studio: http://{host}:{chosen}{path}  (Ctrl+C stops it)", flush=True))
    ui.run(
        host=host,
        port=chosen,
        show=path if show else False,
        reload=False,
        title="tarc studio",
        show_welcome_message=False,
        reconnect_timeout=10.0,
        language="en-US",
    )


async def _prepare() -> None:
    """Start the process of which others are copies, while the page is up already."""
    await asyncio.to_thread(start_first_process)


def free_port(host: str, port: int | None) -> int:
    """Return the port, or the first of `PORTS` that is free.

    Raises
    ------
    InvalidParameter
        For a port that is taken.
    """
    for candidate in PORTS if port is None else [port]:
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((host, candidate))
            except OSError:
                continue
            return candidate
    raise InvalidParameter(f"port: {port or f'{PORTS[0]} to {PORTS[-1]}'} on {host} is taken; give another by --port")
