"""The Study tab: many drawn robots, a cloud that fills, and the run behind each dot."""

import asyncio
import math

import numpy as np
from nicegui import background_tasks, events, ui

from tarc.studio.figures import EMPTY, cloud_figure, curves_figure
from tarc.studio.jobs import Job, JobError, first_result
from tarc.studio.results import CurvePair, StudyChunk, StudyStart
from tarc.studio.run_panel import MEASURES
from tarc.studio.session import Session

MAX_RUNS = 5000


class StudyTab:
    """Settings, the cloud, and the replayed run."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._start: StudyStart | None = None
        self._chunks: list[StudyChunk] = []
        self._job: Job | None = None
        session.at_end(self.stop)
        with ui.element("div").classes("study-columns"):
            with ui.element("section").classes("pane").props('aria-label="Study"'):
                self._build_settings()
                self._cloud = ui.plotly(EMPTY).classes("w-full cloud").mark("cloud")
                self._cloud.props('role=img aria-label="Runs of the study; a click replays one"')
                self._cloud.on("plotly_click", self._on_click)
                self._summary = ui.label().props("aria-live=polite").mark("study-summary")
            with ui.element("section").classes("pane").props('aria-label="Replayed run"'):
                with ui.row().classes("items-center w-full no-wrap gap-2"):
                    self._number = ui.number("Run", value=0, min=0, step=1, format="%d").props(
                        'dense outlined aria-label="Number of the run to replay"'
                    )
                    ui.button("Replay", icon="replay", on_click=self._replay_number).props("dense no-caps outline")
                self._replayed = ui.label("Click a dot, or give the number of a run.").props("aria-live=polite")
                self._curves = {}
                for quantity in ("error", "torque"):
                    plot = ui.plotly(EMPTY).classes("w-full curve")
                    self._curves[quantity] = plot.props(f'role=img aria-label="{quantity} of the replayed run"')

    def _build_settings(self) -> None:
        with ui.row().classes("items-center w-full no-wrap gap-2"):
            self._runs = ui.number("Runs", value=1000, min=8, max=MAX_RUNS, step=8, format="%d")
            self._runs.props('dense outlined aria-label="Number of runs"').mark("study-runs")
            ui.button("Run study", icon="play_arrow", on_click=self.start).props("dense no-caps").mark("study-start")
            ui.button("Stop", icon="stop", on_click=self.stop).props("dense no-caps outline")
        with ui.row().classes("w-full no-wrap gap-2"):
            self._x = ui.select([], label="Over", on_change=self._draw).props("dense outlined").classes("w-1/2")
            self._y = ui.select(MEASURES, label="Measure", value="rms_error", on_change=self._draw)
            self._y.props("dense outlined").classes("w-1/2")
        self._progress = ui.linear_progress(0.0, show_value=False).props('aria-label="Progress of the study"')

    async def start(self) -> None:
        """Run the study of the present design from its beginning."""
        self.stop()
        self._summary.set_text("starting")
        runs = int(min(max(self._runs.value or 8, 8), MAX_RUNS))
        session = self._session
        job = await asyncio.to_thread(Job, "tarc.studio.study_runs:send_study", session.state, session.robots, runs)
        self.stop()
        if session.is_closed:
            job.cancel()
            return
        self._job = job
        background_tasks.create(self._follow(job))

    def stop(self) -> None:
        """End the study; what is there stays."""
        if self._job is not None:
            self._job.cancel()
            self._job = None

    async def _follow(self, job: Job) -> None:
        try:
            async for message in job.results():
                if job is not self._job:
                    return
                if isinstance(message, StudyChunk):
                    self._chunks.append(message)
                    self._draw()
                else:
                    self._begin(message)
        except JobError as error:
            self._summary.set_text(str(error))

    def _begin(self, start: StudyStart) -> None:
        """Show what the study draws, before its first run."""
        self._start, self._chunks = start, []
        keys = list(start.labels)
        self._x.set_options(start.labels, value=next((key for key in keys if key.endswith(".mass")), keys[0]))

    def _draw(self) -> None:
        start = self._start
        if start is None or not self._chunks or self._x.value is None:
            return
        names = self._y.value, f"{self._y.value}_revolute"
        name = next((name for name in names if name in self._chunks[0].measures), names[0])
        column = list(start.labels).index(self._x.value)
        x = np.concatenate([chunk.values[:, column] for chunk in self._chunks])
        empty = np.full((1, 2), math.nan)
        y = np.concatenate([chunk.measures.get(name, np.repeat(empty, len(chunk.runs), 0)) for chunk in self._chunks])
        completed = np.concatenate([chunk.completed for chunk in self._chunks])
        titles = start.labels[self._x.value], f"{MEASURES[self._y.value]} [{start.units[name]}]"
        is_logarithmic = "log_uniform" in start.content["draws"][self._x.value]
        kinds = [str(law["kind"]) for law in start.content["laws"]]
        self._cloud.update_figure(cloud_figure(x, start.scales[name] * y, completed, kinds, titles, is_logarithmic))
        shares = [f"{kind} {share:.1%}" for kind, share in zip(kinds, completed.mean(axis=0), strict=True)]
        runs = start.content["runs"]
        self._progress.set_value(len(x) / runs)
        self._summary.set_text(f"{len(x)} of {runs} runs; completed: {', '.join(shares)}")

    async def _on_click(self, event: events.GenericEventArguments) -> None:
        points = event.args.get("points") or []
        if points and points[0].get("customdata") is not None:
            self._number.set_value(int(points[0]["customdata"]))
            await self._replay_number()

    async def _replay_number(self) -> None:
        if self._start is None:
            self._replayed.set_text("Run a study first.")
            return
        run = int(min(max(self._number.value or 0, 0), self._start.content["runs"] - 1))
        try:
            pair: CurvePair = await first_result("tarc.studio.study_runs:send_replay", self._start.content, run)
        except JobError as error:
            self._replayed.set_text(str(error))
            return
        self._replayed.set_text(f"Run {run}: design {pair.design.status}, rival {pair.rival.status}")
        for quantity, plot in self._curves.items():
            plot.update_figure(curves_figure(pair, quantity, ""))
