"""`tarc show`: list the parts, or describe one."""

from typing import Annotated

import typer

from tarc.cli.options import Json

Name = Annotated[
    str | None,
    typer.Argument(help="A law, robot, estimator, signal or scenario, such as TARC. Default: list them all."),
]


def show(
    name: Name = None,
    as_json: Json = False,
) -> None:
    """List the laws, robots, estimators and signals, or print the parameters of one with units and defaults.

    Example: tarc show TARC
    """
    from tarc.cli.tables import show as tables

    if name is None:
        tables.print_catalogue(as_json)
    else:
        tables.print_kind(name, as_json)
