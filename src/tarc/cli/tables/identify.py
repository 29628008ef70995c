"""Tables of an identified robot."""

from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from tarc.design.identification import IdentifiedInertia
    from tarc.logs.identified_model import IdentifiedModel
    from tarc.logs.least_squares import Interval

HEADERS = {
    "armature": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "dry friction",
    "offset": "torque offset",
}
"""Quantities of each joint, in SI units, and the heads of their columns."""


def print_model(model: "IdentifiedModel", command: str) -> None:
    """Print an identified robot, and the command that designs for it."""
    console = Console()
    table = Table(title="value and 95 % interval, SI units", title_justify="left")
    table.add_column("joint")
    for header in HEADERS.values():
        table.add_column(header, justify="right")
    for i, name in enumerate(model.joint_names):
        table.add_row(escape(name), *(_text(getattr(model, quantity), i) for quantity in HEADERS))
    console.print(table)
    shares = Table(title="explained share of the torque on the end of the record", title_justify="left")
    for header in ("joint", "by the file", "identified on the beginning", "position noise"):
        shares.add_column(header, justify="left" if header == "joint" else "right")
    for i, name in enumerate(model.joint_names):
        by_file, explained = f"{model.explained_by_file[i]:.3f}", f"{model.explained[i]:.3f}"
        shares.add_row(escape(name), by_file, explained, _text(model.encoder_noise, i))
    console.print(shares)
    low, high = model.inertia_ratio
    lines = [f"torque acts after {_text(model.actuation_delay, None, 1e3)} ms"]
    if model.payload is not None:
        lines.append(f"load at the tool: {_text(model.payload, None)} kg")
    lines.append(f"inertia over that of the file, along the record: {low:.3g} to {high:.3g}")
    lines.append("links: identified too" if model.has_links else "links: as in the file")
    for line in (*lines, *model.remarks(), f"design: {command} {' '.join(model.design_options())}"):
        console.print(escape(line), highlight=False)


def print_inertia(inertia: "IdentifiedInertia") -> None:
    """Print M̂ of a record."""
    console = Console()
    table = Table(title="inertia along the record, SI units", title_justify="left")
    for header in ("joint", "M̂", "standard error", "explained share"):
        table.add_column(header, justify="right")
    for i, value in enumerate(np.diag(inertia.inertia)):
        table.add_row(str(i + 1), f"{value:.3g}", f"{inertia.error[i, i]:.2g}", f"{inertia.explained[i]:.2f}")
    console.print(table)
    console.print(f"window {1e3 * inertia.window:g} ms, {inertia.samples} instants", highlight=False)


def inertia_numbers(inertia: "IdentifiedInertia") -> dict[str, Any]:
    """Return M̂ of a record as numbers and lists."""
    return {name: part.tolist() if isinstance(part, np.ndarray) else part for name, part in vars(inertia).items()}


def _text(interval: "Interval", joint: int | None, scale: float = 1.0) -> str:
    """Return a value with its interval, of one joint."""
    value, high = (scale * float(part if joint is None else part[joint]) for part in (interval.value, interval.high))
    return f"{value:.3g} ± {high - value:.2g}"
