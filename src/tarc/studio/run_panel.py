"""The right side of the page: error, torque and gain of the design against its rival."""

from nicegui import ui

from tarc.studio.figures import EMPTY, curves_figure
from tarc.studio.session import Session

ALL_JOINTS = "norm over all joints"
MEASURES = {
    "rms_error": "RMS error",
    "peak_error": "peak error",
    "torque_variation": "torque variation",
    "peak_torque": "peak torque",
}
"""Measures of the table, with what the page calls them; where joints mix, those of the joints that turn."""


class RunPanel:
    """Curves and measures of the two runs."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._joint = ui.select([ALL_JOINTS], value=ALL_JOINTS, label="Joint", on_change=self.update)
        self._joint.props('dense outlined options-dense aria-label="Joint of the curves"').classes("w-full")
        self._problem = ui.label().classes("refusal").props("role=alert").mark("run-problem")
        self._plots = {}
        for quantity in ("error", "torque", "gain"):
            plot = ui.plotly(EMPTY).classes("w-full curve").mark(quantity)
            self._plots[quantity] = plot.props(f'role=img aria-label="{quantity} over time, design and rival"')
        self._measures = ui.element("div").classes("measures").props("aria-live=polite").mark("measures")
        session.listen("runs", self.update)

    def update(self) -> None:
        """Show the newest runs."""
        problem, pair = self._session.results.run_problem, self._session.results.runs
        self._problem.set_text(f"{problem}; the curves are those of an earlier design" if problem and pair else problem)
        if pair is None:
            return
        options = [ALL_JOINTS, *pair.design.joints]
        if options != self._joint.options:
            self._joint.set_options(options, value=ALL_JOINTS)
        joint = self._joint.value if self._joint.value in pair.design.joints else ""
        for quantity, plot in self._plots.items():
            plot.update_figure(curves_figure(pair, quantity, joint))
        has_gain = pair.design.gain is not None or pair.rival.gain is not None
        self._plots["gain"].classes(add="" if has_gain else "absent", remove="absent" if has_gain else "")
        self._measures.clear()
        with self._measures:
            for text in ("", pair.design.name, pair.rival.name):
                ui.label(text).classes("head")
            for name, label in MEASURES.items():
                ui.label(f"{label} [{pair.design.units[name]}]")
                for curves in (pair.design, pair.rival):
                    value = curves.measures.get(name, curves.measures.get(f"{name}_revolute"))
                    ui.label("–" if value is None else f"{value * curves.scales[name]:.4g}")
            ui.label("run")
            for curves in (pair.design, pair.rival):
                ui.label(curves.status)
