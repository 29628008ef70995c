"""Options of `tarc design`: one for each requirement, with the text and the default of `DesignRequirements`."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from typing import Annotated, Any

import typer

from tarc.cli.options import numbers_of
from tarc.core.docstrings import parameter_texts
from tarc.design.requirements import DEFAULT_ENCODER_BITS, LAWS, DesignRequirements

PANEL = "What the design must meet"
WITHOUT_OPTION = ("workspace",)
"""Requirements that Python alone can give."""
NUMBERS = "Numbers | None"
"""Type of a requirement that is one number, or one per joint; an option takes them with commas between."""
METAVARS = {"payload": "LOW HIGH", "law": "|".join(LAWS)}


def requirement_options(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the parameter ``**requirements`` of a command by an option for each requirement."""
    signature = inspect.signature(command)
    own = [part for part in signature.parameters.values() if part.kind is not inspect.Parameter.VAR_KEYWORD]
    texts = parameter_texts(DesignRequirements)
    options = [_option(field, texts[field.name]) for field in fields(DesignRequirements) if field.init]
    signature = signature.replace(parameters=[*own, *(option for option in options if option is not None)])
    command.__signature__ = signature  # pyright: ignore[reportFunctionMemberAccess]
    return command


def _option(field: Field, text: str) -> inspect.Parameter | None:
    """Return the option of a requirement: the period as a rate, the encoder by its bits."""
    text = text.replace("``", "").replace("[", "\\[")
    if field.name in WITHOUT_OPTION:
        return None
    if field.name == "period":
        return _parameter(
            "control_rate", float, 1 / DesignRequirements.period, "Number of control periods per second \\[Hz]."
        )
    if field.name == "sensor":
        return _parameter("encoder_bits", int, DEFAULT_ENCODER_BITS, "Resolution of the encoders \\[bits per turn].")
    if field.type == NUMBERS:
        return _parameter(field.name, str, "", text, metavar="NUMBERS", show_default=False)
    default = None if field.default is MISSING else field.default
    names = [f"--{field.name}"] if field.type is bool else []
    return _parameter(field.name, field.type, default, text, *names, metavar=METAVARS.get(field.name))


def _parameter(name: str, kind: Any, default: object, text: str, *names: str, **more: Any) -> inspect.Parameter:
    annotation = Annotated[kind, typer.Option(*names, help=text, rich_help_panel=PANEL, **more)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def requirements_of(options: dict[str, Any]) -> DesignRequirements:
    """Return the requirements that the options give.

    Raises
    ------
    InvalidParameter
        For an option that is not allowed.
    """
    from tarc.core import validation as check
    from tarc.signals.sensors import Encoder

    kinds = {field.name: field.type for field in fields(DesignRequirements)}
    values = dict(options)
    rate, bits = values.pop("control_rate"), values.pop("encoder_bits")
    for name, value in values.items():
        if kinds[name] == NUMBERS:
            values[name] = numbers_of(f"--{name.replace('_', '-')}", value)
    values["law"] = values["law"].upper()
    period = 1 / check.number("--control-rate", rate, 0, strict=True)
    sensor = Encoder(bits=check.integer("--encoder-bits", bits, 1, 52))
    return DesignRequirements(period=period, sensor=sensor, **values)
