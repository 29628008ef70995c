"""The robot in three dimensions, and the panel that shows the newest run of a session in it."""

from typing import TYPE_CHECKING, Any

import nicegui.elements.scene  # noqa: F401 - registers three.js, which robot_scene.js imports
from nicegui import background_tasks, ui
from nicegui.element import Element

from tarc.core.errors import InvalidParameter
from tarc.studio.session import Session, in_thread

if TYPE_CHECKING:
    from tarc.plants.shapes import RobotGeometry
    from tarc.simulation.run import Run


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
        self._geometry: RobotGeometry | None = None
        self._shown: Run | None = None
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
            while (pair := self._session.results.runs) is not None and pair.design.run is not self._shown:
                self._shown = pair.design.run
                await self._show(self._session.state.robot, pair.design.run)
        finally:
            self._is_busy = False

    async def _show(self, robot: str, run: "Run") -> None:
        """Show a run of a robot."""
        from tarc.studio.scene import robot_message, run_geometry, run_message

        try:
            if robot != self._robot or self._geometry is None:
                self._geometry = await in_thread(run_geometry, run)
                self._robot = robot
                self._scene.show_robot(await in_thread(robot_message, self._geometry, run))
            self._scene.show_run(await in_thread(run_message, self._geometry, run))
        except InvalidParameter as error:
            self._geometry = None
            self._problem.set_text(str(error))
        self._scene.set_visibility(self._geometry is not None)
        self._problem.set_visibility(self._geometry is None)
