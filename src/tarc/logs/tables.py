"""Results of a replayed log as tables of text."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from tarc.logs.replayed import Replay

Table = tuple[str, list[str], list[list[str]]]
"""Title, header and rows of a table."""


def replay_tables(replay: "Replay") -> list[Table]:
    """Return the results as tables of text: timing, then one row per joint of each check."""
    return [
        _timing_table(replay),
        *(_window_tables(replay)),
        *(_torque_tables(replay)),
    ]


def _timing_table(replay: "Replay") -> Table:
    timing = replay.timing
    rows = [
        ["rows", f"{len(replay.log.times)}"],
        ["duration", f"{timing.times[-1] - timing.times[0]:.4g} s"],
        ["period of the robot", f"{1e3 * timing.period:.6g} ms"],
        ["samples per second", f"{timing.rate:.5g} Hz"],
        ["steps of the stamps, standard deviation", f"{1e3 * timing.step_deviation:.3g} ms"],
        ["stamps off the motion, RMS", f"{1e3 * timing.stamp_error:.3g} ms"],
        ["stale rows", f"{timing.stale:.2%}"],
        ["missing periods", f"{timing.missing:.2%}"],
        ["lost positions", f"{timing.lost:.2%}"],
        ["repaired times", "whole periods" if timing.on_clock else "a shift per row"],
    ]
    return "Timing", ["", ""], rows


def _per_joint(
    replay: "Replay", title: str, columns: dict[str, tuple[np.ndarray | None, Callable[[float], str]]]
) -> Table:
    """Return a table with a row per joint, without columns that have no values."""
    shown = {name: (values, spell) for name, (values, spell) in columns.items() if values is not None}
    rows = [
        [name, *(spell(float(values[i])) for values, spell in shown.values())]
        for i, name in enumerate(replay.log.joint_names)
    ]
    return title, ["joint", *shown], rows


def _number(factor: float = 1.0, digits: int = 3) -> Callable[[float], str]:
    return lambda value: f"{factor * value:.{digits}g}"


def _percent(value: float) -> str:
    return f"{value:.1%}"


def _window_tables(replay: "Replay") -> list[Table]:
    timing = replay.timing
    tables = [
        _per_joint(
            replay,
            "Position off the smooth motion [µrad or µm]",
            {
                "stamped": (timing.residual_before, _number(1e6)),
                "repaired": (timing.residual, _number(1e6)),
                "white noise": (replay.record.position_noise(), _number(1e6)),
            },
        )
    ]
    for check in replay.windows:
        predicted = f"{1e3 * check.predicted_delay:.4g} ms"
        tables.append(
            _per_joint(
                replay,
                f"Acceleration of a window of {1e3 * check.window:g} ms, whose delay is predicted as {predicted}",
                {
                    "delay [ms]": (check.delay, lambda value: f"{1e3 * value:.3f}"),
                    "by velocity [ms]": (check.delay_by_velocity, lambda value: f"{1e3 * value:.3f}"),
                    "error by rows": (check.error_of_rows, _number()),
                    "by stamps": (check.error_of_stamps, _number()),
                    "repaired": (check.error, _number()),
                    "delay taken out": (check.error_without_delay, _number()),
                    "predicted noise": (check.noise, _number()),
                },
            )
        )
    if replay.velocity is not None:
        tables.append(
            _per_joint(
                replay,
                "Recorded velocity against the derivative of the position",
                {
                    "late by [ms]": (replay.velocity.delay, lambda value: f"{1e3 * value:.2f}"),
                    "correlation": (replay.velocity.correlation, lambda value: f"{value:.5f}"),
                    "RMS difference": (replay.velocity.error, _number()),
                },
            )
        )
    return tables


def _torque_tables(replay: "Replay") -> list[Table]:
    tables = []
    if replay.model is not None:
        model = replay.model
        tables.append(
            _per_joint(
                replay,
                "Torque that the model explains [N m or N]",
                {
                    "explained": (model.explained, lambda value: f"{value:.3f}"),
                    "not explained": (model.residual, _number()),
                    "mean difference": (model.offset, _number()),
                    "recorded deviation": (model.deviation, _number()),
                },
            )
        )
    if replay.delay_estimation is not None:
        tde = replay.delay_estimation
        tables.append(
            _per_joint(
                replay,
                f"Time-delay estimation leaves, of the torque's deviation, with a window of {1e3 * tde.window:g} ms",
                {
                    "M̂": (np.diag(tde.inertia), _number()),
                    "synchronised": (tde.synchronised, _percent),
                    "literal": (tde.literal, _percent),
                    "synchronised, raw torque": (tde.synchronised_raw, _percent),
                    "literal, raw torque": (tde.literal_raw, _percent),
                },
            )
        )
    if replay.shadow is not None:
        shadow = replay.shadow
        tables.append(
            _per_joint(
                replay,
                f"The law in shadow mode, {shadow.faults} periods in fault",
                {
                    "command − torque": (shadow.difference, _percent),
                    "noise [µrad]": (shadow.position_noise, _number(1e6)),
                    "of the design": (shadow.assumed_noise, _number(1e6)),
                    "torque noise": (shadow.torque_noise, _number()),
                    "by the design": (shadow.predicted_torque_noise, _number()),
                    "error [mrad]": (shadow.error, _number(1e3)),
                    "predicted": (shadow.predicted_error, _number(1e3)),
                },
            )
        )
    return tables
