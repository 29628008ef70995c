"""Options of `tarc design`: one for each requirement, with the text and the default of `DesignRequirements`."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tarc.cli.options import numbers_of
from tarc.core.docstrings import parameter_texts
from tarc.core.errors import InvalidParameter
from tarc.design.requirements import DEFAULT_ENCODER_BITS, LAWS, DesignRequirements

if TYPE_CHECKING:
    from tarc.analysis.workspace import Workspace

PANEL = "What the design must meet"
WITHOUT_OPTION = ("workspace",)
"""Requirements that Python alone can give."""
NUMBERS = "Numbers | None"
"""Type of a requirement that is one number, or one per joint; an option takes them with commas between."""
METAVARS = {"payload": "LOW HIGH", "law": "|".join([*LAWS, "FILE.py:CLASS"])}


def requirement_options(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the parameter ``**requirements`` of a command by an option for each requirement."""
    signature = inspect.signature(command)
    own = [part for part in signature.parameters.values() if part.kind is not inspect.Parameter.VAR_KEYWORD]
    texts = parameter_texts(DesignRequirements)
    options = [
        option
        for field in fields(DesignRequirements)
        if field.init and field.name not in WITHOUT_OPTION
        for option in _options(field, texts[field.name])
    ]
    signature = signature.replace(parameters=[*own, *options])
    command.__signature__ = signature
    return command


def _options(field: Field, text: str) -> list[inspect.Parameter]:
    """Return the options of a requirement: the period as a rate, the encoder by its bits or its resolution."""
    text = text.replace("``", "").replace("[", "\\[")
    if field.name == "period":
        text = "Number of control periods per second \\[Hz]."
        return [_parameter("control_rate", float, 1 / DesignRequirements.period, text)]
    if field.name == "sensor":
        bits = (
            "Resolution of the encoders \\[bits per turn, or per 2π m of a linear scale], one number or one per joint."
        )
        step = "Step of the encoders \\[rad or m], one number or one per joint, instead of the bits."
        return [
            _parameter("encoder_bits", str, str(DEFAULT_ENCODER_BITS), bits, metavar="NUMBERS"),
            _parameter("encoder_resolution", str, "", step, metavar="NUMBERS", show_default=False),
        ]
    if field.type == NUMBERS:
        return [_parameter(field.name, str, "", text, metavar="NUMBERS", show_default=False)]
    default = None if field.default is MISSING else field.default
    names = [f"--{field.name}"] if field.type is bool else []
    return [_parameter(field.name, field.type, default, text, *names, metavar=METAVARS.get(field.name))]


def _parameter(name: str, kind: Any, default: object, text: str, *names: str, **more: Any) -> inspect.Parameter:
    annotation = Annotated[kind, typer.Option(*names, help=text, rich_help_panel=PANEL, **more)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def requirements_of(options: dict[str, Any], workspace: "Workspace | None" = None) -> DesignRequirements:
    """Return the requirements that the options give, on a workspace or on the default one.

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
    resolution = numbers_of("--encoder-resolution", values.pop("encoder_resolution"))
    for name, value in values.items():
        if kinds[name] == NUMBERS:
            values[name] = numbers_of(f"--{name.replace('_', '-')}", value)
    if "." not in values["law"]:
        values["law"] = values["law"].upper()
    period = 1 / check.number("--control-rate", rate, 0, strict=True)
    if resolution is None:
        sensor = Encoder(bits=_bits(bits))
    elif bits == str(DEFAULT_ENCODER_BITS):
        sensor = Encoder(resolution=resolution)
    else:
        raise InvalidParameter("--encoder-bits, --encoder-resolution: both are given; give one of them")
    return DesignRequirements(period=period, sensor=sensor, workspace=workspace, **values)


def _bits(text: str) -> int | list[int]:
    """Return the bits of all encoders, or those of each joint."""
    from tarc.core import validation as check

    try:
        values = [int(part) for part in text.split(",")]
    except ValueError:
        raise InvalidParameter(f"--encoder-bits: got {text!r}; needs whole numbers from 1 to 52") from None
    bits = [check.integer("--encoder-bits", value, 1, 52) for value in values]
    return bits if len(bits) > 1 else bits[0]
