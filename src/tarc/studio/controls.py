"""The left side of the page: sliders with numbers, choices and presets."""

import math
from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from tarc.studio.design_state import CONTROLS, LAWS, PRESETS, RIVALS, Control
from tarc.studio.session import Session

SIGNIFICANT_DIGITS = 3
SLIDER_PERIOD = 0.04
"""Shortest time between two values that a slider sends [s]."""
EMIT_VALUE = "(event) => emit(event.target.value)"


def slider_position(control: Control, value: float) -> float:
    """Return where the slider stands for a value."""
    return math.log10(value) if control.is_logarithmic else value


def slider_value(control: Control, position: float) -> float:
    """Return the value of a position of the slider, to three digits on a logarithmic one."""
    value = 10**position if control.is_logarithmic else position
    return control.clip(float(f"{value:.{SIGNIFICANT_DIGITS}g}") if control.is_logarithmic else value)


class ControlRow:
    """One number of the design: its name, a field for the exact value, and a slider."""

    def __init__(self, session: Session, control: Control) -> None:
        self._session = session
        self._control = control
        self._is_syncing = False
        unit = f" [{control.unit}]" if control.unit else ""
        label = f"{control.label}{unit}"
        value = getattr(session.state, control.name)
        self.row = ui.element("div").classes("control-row")
        with self.row:
            ui.label(label).classes("control-label").tooltip(control.hint)
            self._number = ui.number(value=value, format="%.7g", on_change=self._on_number)
            self._number.props(f'dense borderless debounce=300 aria-label="{label}, exact value"')
            self._number.classes("control-number").mark(f"{control.name}-number")
            self._slider = ui.element("input").classes("control-slider").mark(control.name)
            low, high = slider_position(control, control.low), slider_position(control, control.high)
            self._slider.props(f'type=range min={low:.6g} max={high:.6g} step={control.step} aria-label="{label}"')
            self._slider.on("input", self._on_slider, throttle=SLIDER_PERIOD, js_handler=EMIT_VALUE)
        self._position = math.nan
        self._shown = math.nan
        self.sync()

    def sync(self) -> None:
        """Show the value of the present design."""
        value = getattr(self._session.state, self._control.name)
        self.row.set_visibility(not self._control.adaptive or self._session.state.law == "TARC")
        if value == self._shown:
            return
        self._shown = value
        self._is_syncing = True
        self._number.set_value(value)
        if math.isnan(self._position) or slider_value(self._control, self._position) != value:
            self._position = slider_position(self._control, value)
            self._slider.props["value"] = f"{self._position:.6g}"
        self._slider.props["aria-valuetext"] = f"{value:.7g} {self._control.unit}"
        self._slider.update()
        self._is_syncing = False

    def _on_slider(self, event: events.GenericEventArguments) -> None:
        self._position = float(event.args)
        self._slider.props["value"] = event.args
        value = slider_value(self._control, self._position)
        self._session.change(self._control.name, **{self._control.name: value})

    def _on_number(self, event: events.ValueChangeEventArguments) -> None:
        if not self._is_syncing and event.value is not None:
            changes: dict[str, Any] = {self._control.name: float(event.value)}
            self._session.change(**changes)


class ControlPanel:
    """All controls of a design."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._is_syncing = False
        state = session.state
        self._robot = self._choice("Robot", dict(session.robots.labels), state.robot, "robot")
        with ui.row().classes("w-full no-wrap gap-2"):
            self._law = self._choice("Law", {name: name for name in LAWS}, state.law, "law")
            self._rival = self._choice("Rival", {name: name for name in RIVALS}, state.rival, "rival")
        with ui.row().classes("gap-1").props('role=group aria-label="Presets"'):
            for name, changes in PRESETS.items():
                ui.button(name, on_click=self._preset(changes), color=None).props("dense outline no-caps size=sm")
        self._rows = [ControlRow(session, control) for control in CONTROLS]
        with ui.row().classes("gap-x-4 gap-y-0"):
            self._model = ui.checkbox("Model known, M̂(q)", value=state.model_known, on_change=self._set("model_known"))
            self._synchronised = ui.checkbox(
                "Synchronised", value=state.synchronised, on_change=self._set("synchronised")
            )
        session.listen("state", self.sync)

    def sync(self) -> None:
        """Show the present design."""
        state = self._session.state
        self._is_syncing = True
        if set(self._robot.options) != set(self._session.robots.labels):
            self._robot.set_options(dict(self._session.robots.labels))
        self._robot.set_value(state.robot)
        self._law.set_value(state.law)
        self._rival.set_value(state.rival)
        self._model.set_value(state.model_known)
        self._synchronised.set_value(state.synchronised)
        self._is_syncing = False
        for row in self._rows:
            row.sync()

    def _choice(self, label: str, options: dict[str, str], value: str, name: str) -> ui.select:
        choice = ui.select(options, label=label, value=value, on_change=self._set(name))
        return choice.props(f'dense outlined options-dense aria-label="{label}"').classes("w-full").mark(name)

    def _set(self, name: str) -> Callable[[events.ValueChangeEventArguments], None]:
        def set_value(event: events.ValueChangeEventArguments) -> None:
            if not self._is_syncing:
                self._session.change(**{name: event.value})

        return set_value

    def _preset(self, changes: dict[str, Any]) -> Callable[[], None]:
        return lambda: self._session.change(**changes)
