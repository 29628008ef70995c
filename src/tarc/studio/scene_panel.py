"""The robot in three dimensions, and the panel that shows the newest run of a session in it."""

from typing import Any

import nicegui.elements.scene  # noqa: F401 - registers three.js, which robot_scene.js imports
from nicegui import background_tasks, ui
from nicegui.element import Element

from tarc.studio.jobs import JobError
from tarc.studio.results import CurvePair
from tarc.studio.session import Session


class RobotScene(Element, component="robot_scene.js"):
    """Scene with its own time slider and play button; it moves in the browser, without messages.

    Parameters
    ----------
    curves
        CSS selector of the plots over time that show the present time as a line.
    """

    def __init__(self, curves: str = ".curve.js-plotly-plot, .curve .js-plotly-plot") -> None:
        super().__init__()
        self._props["label"] = "Robot in three dimensions, its reference as a blue ghost"
        self._props["curves"] = curves

    def show_robot(self, robot: dict[str, Any]) -> None:
        """Show another robot, as of `robot_message`."""
        self.run_method("set_robot", robot)

    def show_run(self, run: dict[str, Any]) -> None:
        """Play another run, as of `run_message`."""
        self.run_method("set_run", run)


class ScenePanel:
    """Scene, or a line that says why there is none."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._scene = RobotScene().mark("scene")
        self._problem = ui.label().classes("text-caption")
        self._problem.set_visibility(False)
        self._robot = ""
        self._shown: CurvePair | None = None
        self._is_busy = False
        session.listen("runs", self.update)

    def update(self) -> None:
        """Show the newest run."""
        if not self._is_busy:
            background_tasks.create(self._follow(), name="scene")

    async def _follow(self) -> None:
        """Show runs until the newest one is shown."""
        self._is_busy = True
        try:
            while (pair := self._session.results.runs) is not None and pair is not self._shown:
                self._shown = pair
                await self._show()
        finally:
            self._is_busy = False

    async def _show(self) -> None:
        """Show the newest run."""
        problem = ""
        try:
            messages = await self._session.newest_scene(self._robot)
            if messages is not None:
                self._robot, robot, run = messages
                if robot is not None:
                    self._scene.show_robot(robot)
                self._scene.show_run(run)
        except JobError as error:
            self._robot = ""
            problem = str(error)
        self._problem.set_text(problem)
        self._scene.set_visibility(not problem)
        self._problem.set_visibility(bool(problem))
