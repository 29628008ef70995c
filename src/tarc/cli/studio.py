"""`tarc studio`: shape a controller by hand in the browser."""

from typing import Annotated

import typer

Scenario = Annotated[
    str | None, typer.Argument(help="A YAML file, or the name of a shipped scenario. Default: a two-link arm.")
]
Host = Annotated[
    str, typer.Option(help="Address to listen on. Any but that of this machine needs the token of the printed URL.")
]
Port = Annotated[int | None, typer.Option(min=1, max=65535, help="Port to listen on. Default: a free one.")]
Open = Annotated[bool, typer.Option("--open/--no-open", help="Open a browser.")]


def studio(scenario: Scenario = None, host: Host = "127.0.0.1", port: Port = None, show: Open = True) -> None:
    """Shape a controller by hand in the browser and watch its loop, certificates and runs.

    The page is served on this machine alone, and nothing on it asks another.

    Example: tarc studio ur5e
    """
    from tarc.studio.server import serve

    serve(scenario, host, port, show)
