"""The middle of the page: stability map, loop gain, noise, distance from the optimum, certificates."""

import math

from nicegui import events, ui

from tarc.studio.design_state import CONTROLS
from tarc.studio.figures import EMPTY, gain_figure, map_figure
from tarc.studio.session import Session

VERDICT_ICONS = {"certified": "check_circle", "refuted": "cancel", "inconclusive": "help"}
KEY_FACTORS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
KEY_STEP = 1.05
"""Factor by which an arrow key moves the dot."""
DRAG_PERIOD = 0.04
"""Shortest time between two places of the dragged dot that the browser sends [s]."""
RANGES = {control.name: control for control in CONTROLS}


class LoopPanel:
    """The map with its dot, and the numbers of the loop."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._map = ui.plotly(EMPTY).classes("w-full map")
        self._map.props(
            'tabindex=0 role=application aria-label="Stability map. The arrow keys move the design: '
            'left and right its natural frequency, up and down its inertia share."'
        ).mark("map")
        self._map.on("dot", self._on_drag, ["detail"], throttle=DRAG_PERIOD)
        self._map.on("keydown", self._on_key, ["key"])
        self._summary = ui.element("dl").classes("numbers").props('aria-live=polite aria-label="Numbers of the loop"')
        self._gain = ui.plotly(EMPTY).classes("w-full gain")
        self._gain.props('role=img aria-label="Loop gain over frequency"')
        session.listen("loop", self.update)

    def update(self) -> None:
        """Show the newest analysis."""
        results = self._session.results
        if results.problem or results.loop is None or results.facts is None:
            self._show([("Problem", results.problem)])
            return
        loop, facts = results.loop, results.facts
        self._map.update_figure(map_figure(self._session.state, loop, facts))
        self._gain.update_figure(gain_figure(loop))
        low, high = loop.ratios[0], loop.ratios[2]
        stable = "none" if loop.stable is None else f"{loop.stable[0]:.3g} … {loop.stable[1]:.3g}"
        optimum = "loop unstable"
        if math.isfinite(loop.error_over_optimum):
            optimum = f"{loop.error_over_optimum:.2f} × error, {loop.change_over_optimum:.2f} × torque change"
        noise = f"{loop.torque_noise:.3g} N m RMS" if math.isfinite(loop.torque_noise) else "loop unstable"
        self._show(
            [
                ("Linear loop", "stable" if all(loop.is_stable) else "unstable at some inertia of the motion"),
                ("Stable inertia ratios", stable),
                ("Ratios of the robot", f"{low:.3g} … {high:.3g}"),
                ("Torque noise", noise),
                ("Crossover", f"{loop.crossover:.3g} rad/s"),
                ("Over the optimal controller", optimum),
            ]
        )

    def _show(self, pairs: list[tuple[str, str]]) -> None:
        self._summary.clear()
        with self._summary:
            for name, value in pairs:
                with ui.element("div"):
                    with ui.element("dt"):
                        ui.label(name)
                    with ui.element("dd"):
                        ui.label(value)

    def _on_drag(self, event: events.GenericEventArguments) -> None:
        place = event.args["detail"]
        self._session.change(
            "map drag",
            natural_frequency=float(f"{float(place['frequency']):.3g}"),
            inertia_share=float(f"{float(place['share']):.3g}"),
        )

    def _on_key(self, event: events.GenericEventArguments) -> None:
        if event.args["key"] in KEY_FACTORS:
            right, up = KEY_FACTORS[event.args["key"]]
            state = self._session.state
            self._session.change(
                "map keys",
                natural_frequency=float(f"{state.natural_frequency * KEY_STEP**right:.4g}"),
                inertia_share=float(f"{state.inertia_share * KEY_STEP**up:.4g}"),
            )


class CertificatePanel:
    """The certificates with verdict, margin and reason."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with ui.row().classes("items-center gap-2"):
            ui.label("Certificates").classes("section-title").props("role=heading aria-level=2")
            self._computing = ui.row().classes("items-center gap-1").props("role=status")
            with self._computing:
                ui.spinner(size="1.1em")
                ui.label("computing")
        self._table = ui.element("div").classes("certificates").props("aria-live=polite").mark("certificates")
        session.listen("certificates", self.update)

    def update(self) -> None:
        """Show the certificates of the present design; while they are computed, the old ones are faded."""
        results = self._session.results
        is_computing = results.certificates is None and not results.certificate_problem
        self._computing.set_visibility(is_computing)
        if is_computing:
            self._table.classes(add="stale")
            return
        self._table.classes(remove="stale")
        self._table.clear()
        with self._table:
            if results.certificate_problem:
                ui.label(results.certificate_problem)
            for row in results.certificates or []:
                with ui.element("div").classes(f"certificate {row.verdict}"):
                    ui.icon(VERDICT_ICONS[row.verdict]).props("aria-hidden=true")
                    ui.label(row.label).classes("name").tooltip(row.claim)
                    ui.label(row.verdict).classes("verdict")
                    ui.label(f"{row.margin:.3g}").classes("margin")
                    ui.label(row.reason).classes("reason")
