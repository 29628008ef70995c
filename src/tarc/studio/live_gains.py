"""Sliders of the Live tab: gains that change while the loop runs, within their certified range."""

import math
from collections.abc import Callable

from nicegui import events, ui

from tarc.studio.controls import EMIT_VALUE, slider_position, slider_value
from tarc.studio.design_state import CONTROLS, Control
from tarc.studio.results import LiveGain

Change = Callable[[str, float], object]


class GainRow:
    """A gain: its certified range, a field for the exact value, and a slider that stays within."""

    def __init__(self, control: Control, gain: LiveGain, on_change: Change) -> None:
        self._control, self._gain, self._on_change = control, gain, on_change
        self._shown = gain.value
        unit = f" [{control.unit}]" if control.unit else ""
        label = f"{control.label}{unit}"
        with ui.element("div").classes("control-row"):
            ui.label(label).classes("control-label")
            self._number = ui.number(value=gain.value, format="%.7g")
            self._number.on("keydown.enter", self._on_number).on("blur", self._on_number)
            self._number.props(f'dense borderless aria-label="{label} while it runs, exact value"')
            self._number.classes("control-number").mark(f"live-{control.name}-number")
            self._slider = ui.element("input").classes("control-slider").mark(f"live-{control.name}")
            self._slider.props(f'type=range aria-label="{label} while it runs"')
            self._slider.on("change", self._on_slider, js_handler=EMIT_VALUE)
            self._range = ui.label().classes("gain-range")
        self.sync(gain)

    def sync(self, gain: LiveGain) -> None:
        """Show a range and a value."""
        self._gain = gain
        if gain.values:
            nearest = min(gain.values, key=lambda value: abs(value - gain.value))
            low, high, step, position = 0.0, len(gain.values) - 1.0, "1", gain.values.index(nearest)
        else:
            low, high = (slider_position(self._control, end) for end in self._ends())
            step, position = "any", slider_position(self._control, gain.value)
        self._slider.props(f"min={low:.6g} max={high:.6g} step={step} value={position:.6g}")
        self._slider.props["aria-valuetext"] = f"{gain.value:.7g} {self._control.unit}"
        self._slider.update()
        self._range.set_text(f"certified: {gain.text}")
        self._shown = gain.value
        self._number.set_value(gain.value)

    def _ends(self) -> tuple[float, float]:
        """Return the ends of the slider: those of the range, or of the Design tab's where there is no limit."""
        if math.isinf(self._gain.high):
            return self._control.low, self._control.high
        return self._gain.low, self._gain.high

    def restore(self) -> None:
        """Show the range and the value that run."""
        self.sync(self._gain)

    def set_enabled(self, is_enabled: bool) -> None:
        """Let the gain change, or not."""
        self._number.set_enabled(is_enabled)
        self._slider.props(remove="disabled") if is_enabled else self._slider.props("disabled")
        self._slider.update()

    def _on_slider(self, event: events.GenericEventArguments) -> None:
        position = float(event.args)
        if self._gain.values:
            self._on_change(self._control.name, self._gain.values[round(position)])
        else:
            low, high = self._ends()
            self._on_change(self._control.name, min(max(slider_value(self._control, position), low), high))

    def _on_number(self) -> None:
        value = self._number.value
        if value is not None and value != self._shown:
            self._shown = value
            self._on_change(self._control.name, float(value))


class GainPanel:
    """All gains that may change while the loop runs, and what was refused."""

    def __init__(self, on_change: Change) -> None:
        self._on_change = on_change
        self._rows: dict[str, GainRow] = {}
        ui.label("Gains while it runs").classes("section-title").props("role=heading aria-level=2")
        self._note = ui.label().classes("text-caption").props("role=status").mark("live-gains-note")
        self._box = ui.element("div").classes("w-full")
        self._refusal = ui.label().classes("refusal").props("role=alert").mark("live-refusal")
        self.end()

    def show(self, gains: dict[str, LiveGain], note: str) -> None:
        """Show gains with their ranges and values."""
        if set(gains) != set(self._rows):
            self._box.clear()
            controls = {control.name: control for control in CONTROLS}
            with self._box:
                self._rows = {name: GainRow(controls[name], gain, self._on_change) for name, gain in gains.items()}
        for name, gain in gains.items():
            self._rows[name].sync(gain)
            self._rows[name].set_enabled(True)
        self._note.set_text(note)
        self._refusal.set_text("")

    def wait(self, name: str, value: float) -> None:
        """Show that a change is on its way."""
        self._note.set_text(f"preparing {name.replace('_', ' ')} {value:.7g}")
        self._refusal.set_text("")

    def refuse(self, text: str) -> None:
        """Show why a change was refused, and the value that runs."""
        for row in self._rows.values():
            row.restore()
        self._note.set_text("unchanged")
        self._refusal.set_text(text)

    def end(self) -> None:
        """Let no gain change, since no loop runs."""
        for row in self._rows.values():
            row.set_enabled(False)
        self._note.set_text("Gains change while the loop runs, if the law is certified, and within what is certified.")
