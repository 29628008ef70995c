"""`tarc show`: list the parts, or describe one."""

from typing import Annotated

import typer

from tarc.cli.options import Json


def show(
    name: Annotated[str | None, typer.Argument(help="A law, plant, estimator or signal, e.g. TARC.")] = None,
    as_json: Json = False,
) -> None:
    """List the laws, robots, estimators and signals there are, or the parameters of one.

    Example: tarc show TARC
    """
    from tarc.cli import tables

    if name is None:
        tables.print_catalogue(as_json)
    else:
        tables.print_kind(name, as_json)
