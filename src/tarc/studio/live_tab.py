"""The Live tab: the design on a robot, with error, torque and jitter as they are measured, and gains that change."""

from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

from tarc.studio.figures import live_figure
from tarc.studio.jobs import Job, JobError, process_context
from tarc.studio.live_gains import GainPanel
from tarc.studio.live_reader import LiveReader, LiveRows
from tarc.studio.results import LiveEnd, LiveGains, LiveLog, LiveRefusal, LiveStage
from tarc.studio.session import Session

REFRESH = 0.05
"""Time between two looks at the loop [s]."""
DRAWING_TIME = 2.0
"""Longest wait for the browser to draw [s]."""
MAX_POINTS = 600
"""Points of a curve that stay."""
POINTS_PER_LOOK = 2
"""Points that a curve gets in the time of a look."""
DEFAULT_DURATION = 60
"""[s]."""
QUANTITIES = {"error": "error, norm", "torque": "torque, norm", "lateness": "jitter: lateness [µs]"}
"""Curves, with their titles; those of error and torque get the units of the robot."""
ROBOTS = {
    "mujoco": "Simulated robot",
    "mujoco:udp": "Simulated robot over UDP",
    "udp": "Robot over UDP",
    "dds": "Robot of ROS 2 over DDS",
}
NUMBERS = {
    "time": "time [s]",
    "phase": "phase",
    "error": "error",
    "torque": "torque",
    "lateness": "jitter [µs]",
}
FORMATS = {"error": ".3g", "torque": ".3g", "lateness": ".0f"}


class LiveTab:
    """Connection, gains, and rolling curves."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._job: Job | None = None
        self._commands: Connection | None = None
        self._reader: LiveReader | None = None
        session.at_end(self.stop)
        with ui.element("div").classes("live-columns"):
            with ui.element("section").classes("pane").props('aria-label="Connection and gains"'):
                self._build_connection()
                ui.separator()
                self._gains = GainPanel(self.change)
            with ui.element("section").classes("pane").props('aria-label="Measurements"'):
                self._build_measurements()
        self._timer = ui.timer(REFRESH, self._look, active=False)

    def _build_connection(self) -> None:
        self._robot = ui.select(ROBOTS, value="mujoco", label="Robot").classes("w-full").mark("live-robot")
        self._robot.props('dense outlined options-dense aria-label="Robot of the loop"')
        self._address = ui.input("Address").classes("w-full").bind_visibility_from(self._robot, "value", _has_address)
        self._address.props('dense outlined aria-label="host:port, or the controller of ROS 2"').mark("live-address")
        self._address.tooltip("host:port over UDP; the name of the effort controller over DDS")
        self._duration = ui.number("Duration [s]", value=DEFAULT_DURATION, min=1, max=3600).classes("w-full")
        self._duration.props('dense outlined aria-label="Duration in seconds"')
        with ui.row().classes("gap-2"):
            self._start = ui.button("Start", icon="play_arrow", on_click=self.start).props("dense no-caps")
            self._start.mark("live-start")
            self._stop = ui.button("Stop", icon="stop", on_click=self.stop, color=None).props("dense no-caps outline")
            self._stop.mark("live-stop").set_enabled(False)
        self._status = ui.label("Not connected.").props("role=status").mark("live-status")

    def _build_measurements(self) -> None:
        self._numbers, self._titles = {}, {}
        with ui.element("dl").classes("numbers live-numbers"):
            for name, title in NUMBERS.items():
                with ui.element("div"):
                    with ui.element("dt"):
                        self._titles[name] = ui.label(title)
                    with ui.element("dd"):
                        self._numbers[name] = ui.label("–").mark(f"live-number-{name}")
        self._plot = ui.plotly(live_figure(list(QUANTITIES.values()))).classes("w-full live-curves").mark("live-curves")
        self._plot.props('role=img aria-label="error, torque and jitter over time, measured"')

    def start(self) -> None:
        """Start the loop of the present design."""
        if self._job is not None:
            return
        session = self._session
        self._plot.update_figure(live_figure(list(QUANTITIES.values())))
        self._status.set_text("starting")
        self._set_running(True)
        receiver, self._commands = process_context().Pipe(duplex=False)
        self._job = Job(
            "tarc.studio.live_runs:send_live",
            session.state,
            session.robots,
            self._robot.value,
            self._address.value,
            float(self._duration.value or DEFAULT_DURATION),
            receiver,
        )
        receiver.close()
        background_tasks.create(self._follow(self._job))

    def stop(self) -> None:
        """Let the robot come to rest and close its brakes."""
        if self._job is not None:
            self._job.interrupt()

    def change(self, name: str, value: float) -> None:
        """Change a gain of the loop that runs; it answers whether the value is certified."""
        if self._commands is None:
            return
        self._gains.wait(name, value)
        try:
            self._commands.send({name: value})
        except OSError:
            self._gains.refuse("the loop has ended")

    async def _follow(self, job: Job) -> None:
        text = "the loop's process ended"
        try:
            async for message in job.results():
                text = self._take(message) or text
        except JobError as error:
            text = str(error)
        except FileNotFoundError:
            text = "the run is over already"
        finally:
            self._timer.deactivate()
            if self._commands is not None:
                self._commands.close()
            self._reader = self._job = self._commands = None
            self._set_running(False)
            self._gains.end()
        self._status.set_text(text)

    def _take(self, message: object) -> str:
        """Show what the loop's process sent; return how it ended, if that was it."""
        if isinstance(message, LiveStage):
            self._status.set_text(message.text)
        elif isinstance(message, LiveLog):
            self._reader = LiveReader(message)
            self._show_units(self._reader.units)
            self._timer.activate()
            self._status.set_text("running")
        elif isinstance(message, LiveGains):
            values = ", ".join(f"{name.replace('_', ' ')} {gain.value:.7g}" for name, gain in message.gains.items())
            self._gains.show(message.gains, message.reason or f"running with {values}")
        elif isinstance(message, LiveRefusal):
            self._gains.refuse(message.text)
        elif isinstance(message, LiveEnd):
            return message.text
        return ""

    def _set_running(self, is_running: bool) -> None:
        """Let the loop be started, or stopped."""
        self._start.set_enabled(not is_running)
        self._stop.set_enabled(is_running)

    def _show_units(self, units: dict[str, str]) -> None:
        """Show the units of the robot that runs."""
        axes = {}
        for place, (name, title) in enumerate(QUANTITIES.items()):
            if name in units:
                self._titles[name].set_text(f"{NUMBERS[name]} [{units[name]}]")
                axes[f"yaxis{place + 1 if place else ''}.title.text"] = f"{title} [{units[name]}]"
        self._plot.run_plot_method("relayout", axes)

    async def _look(self) -> None:
        """Add what was measured since the last look, and wait until the browser has drawn it."""
        rows = None if self._reader is None else self._reader.read()
        if rows is None:
            return
        peaks = _peaks(rows)
        self._numbers["time"].set_text(f"{rows.times[-1]:.2f}")
        self._numbers["phase"].set_text(rows.phase)
        for name, (_, values) in peaks.items():
            known = [value for value in values if value is not None]
            self._numbers[name].set_text(f"{max(known):{FORMATS[name]}}" if known else "–")
        update = {"x": [peaks[name][0] for name in QUANTITIES], "y": [peaks[name][1] for name in QUANTITIES]}
        traces = list(range(len(QUANTITIES)))
        with suppress(TimeoutError):  # a browser that is busy, or gone
            await self._plot.run_plot_method("extendTraces", update, traces, MAX_POINTS, timeout=DRAWING_TIME)


def _has_address(robot: str) -> bool:
    return robot in ("udp", "dds")


def _peaks(rows: LiveRows) -> dict[str, tuple[list[float], list[Any]]]:
    """Return the largest values in a few parts of the rows, since a curve has fewer points than the loop has rows."""
    looks = (rows.times[-1] - rows.times[0]) / REFRESH  # several, where the browser was busy
    n_points = int(np.clip(POINTS_PER_LOOK * np.ceil(looks), 1, min(MAX_POINTS, len(rows.times))))
    parts = np.array_split(np.arange(len(rows.times)), n_points)
    curves = {"error": rows.errors, "torque": rows.torques, "lateness": rows.lateness}
    peaks = {}
    for name, values in curves.items():
        largest = [values[part][np.isfinite(values[part])].max(initial=-1.0) for part in parts]
        times = [round(float(rows.times[part[-1]]), 4) for part in parts]
        peaks[name] = times, [float(f"{value:.5g}") if value >= 0 else None for value in largest]
    return peaks
