"""The Live tab: the design on a robot, with error, torque and jitter as they are measured."""

from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import background_tasks, ui

from tarc.studio.figures import live_figure
from tarc.studio.jobs import Job, JobError
from tarc.studio.session import Session

if TYPE_CHECKING:
    from tarc.studio.live_runs import LiveReader, LiveRows

REFRESH = 0.05
"""Time between two looks at the loop [s]."""
MAX_POINTS = 600
"""Points of a curve that stay."""
POINTS_PER_LOOK = 2
"""Points that a look adds to a curve."""
QUANTITIES = {"error": "error, norm", "torque": "torque, norm", "lateness": "lateness [µs]"}
ROBOTS = {
    "mujoco": "Simulated robot",
    "mujoco:udp": "Simulated robot over UDP",
    "udp": "Robot over UDP",
    "dds": "Robot of ROS 2 over DDS",
}
FIXED_GAINS = (
    "The loop is built for one law, and no gain of it changes while it runs. Stop it, change the design, look at its "
    "certificates, and start it again."
)


class LiveTab:
    """Connection, state and rolling curves."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._job: Job | None = None
        self._reader: LiveReader | None = None
        session.at_end(self.stop)
        with ui.element("div").classes("live-columns"):
            with ui.element("section").classes("pane").props('aria-label="Connection"'):
                self._build_connection()
            with ui.element("section").classes("pane").props('aria-label="Measurements"'):
                self._plots = {}
                for name, title in QUANTITIES.items():
                    plot = ui.plotly(live_figure(title)).classes("w-full curve").mark(f"live-{name}")
                    self._plots[name] = plot.props(f'role=img aria-label="{title} over time, measured"')
        self._timer = ui.timer(REFRESH, self._look, active=False)

    def _build_connection(self) -> None:
        self._robot = ui.select(ROBOTS, value="mujoco", label="Robot").classes("w-full").mark("live-robot")
        self._robot.props('dense outlined options-dense aria-label="Robot of the loop"')
        self._address = ui.input("Address").classes("w-full").bind_visibility_from(self._robot, "value", _has_address)
        self._address.props('dense outlined aria-label="host:port, or the controller of ROS 2"')
        self._address.tooltip("host:port over UDP; the name of the effort controller over DDS")
        self._duration = ui.number("Duration [s]", value=10, min=1, max=3600).classes("w-full")
        self._duration.props('dense outlined aria-label="Duration in seconds"')
        with ui.row().classes("gap-2"):
            ui.button("Start", icon="play_arrow", on_click=self.start).props("dense no-caps").mark("live-start")
            ui.button("Stop", icon="stop", on_click=self.stop).props("dense no-caps outline").mark("live-stop")
        self._status = ui.label("Not connected.").props("role=status").mark("live-status")
        ui.label(FIXED_GAINS).classes("text-caption")

    def start(self) -> None:
        """Start the loop of the present design."""
        from tarc.studio.live_runs import send_live

        if self._job is not None:
            return
        session = self._session
        content = session.state.to_content(session.robots.content(session.state.robot))
        for name, title in QUANTITIES.items():
            self._plots[name].update_figure(live_figure(title))
        self._status.set_text("connecting")
        self._job = Job(send_live, content, self._robot.value, self._address.value, float(self._duration.value or 10))
        background_tasks.create(self._follow(self._job))

    def stop(self) -> None:
        """Let the robot come to rest and close its brakes."""
        if self._job is not None:
            self._job.interrupt()

    async def _follow(self, job: Job) -> None:
        from tarc.studio.live_runs import LiveEnd, LiveLog, LiveReader

        text = "the loop's process ended"
        try:
            async for message in job.results():
                if isinstance(message, LiveLog):
                    self._reader = LiveReader(message)
                    self._timer.activate()
                elif isinstance(message, LiveEnd):
                    text = message.text
        except JobError as error:
            text = str(error)
        except FileNotFoundError:
            text = "the run is over already"
        finally:
            self._timer.deactivate()
            self._reader = None
            self._job = None
        self._status.set_text(text)

    def _look(self) -> None:
        """Add what was measured since the last look."""
        rows = None if self._reader is None else self._reader.read()
        if rows is None:
            return
        late = rows.lateness[np.isfinite(rows.lateness)]
        jitter = f", late {late.max():.0f} µs" if late.size else ""
        self._status.set_text(f"{rows.times[-1]:.2f} s, {rows.phase}, error {rows.errors[-1]:.4g}{jitter}")
        for name, values in _peaks(rows).items():
            update = {"x": [values[0]], "y": [values[1]]}
            self._plots[name].run_plot_method("extendTraces", update, [0], MAX_POINTS)


def _has_address(robot: str) -> bool:
    return robot in ("udp", "dds")


def _peaks(rows: "LiveRows") -> dict[str, tuple[list[float], list[Any]]]:
    """Return the largest values in a few parts of the rows, since a curve has fewer points than the loop has rows."""
    parts = np.array_split(np.arange(len(rows.times)), min(POINTS_PER_LOOK, len(rows.times)))
    curves = {"error": rows.errors, "torque": rows.torques, "lateness": rows.lateness}
    peaks = {}
    for name, values in curves.items():
        largest = [values[part][np.isfinite(values[part])].max(initial=-1.0) for part in parts]
        times = [round(float(rows.times[part[-1]]), 4) for part in parts]
        peaks[name] = times, [float(f"{value:.5g}") if value >= 0 else None for value in largest]
    return peaks
