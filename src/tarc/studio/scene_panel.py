"""The scene of a session: the newest run of its design."""

from nicegui import background_tasks, ui

from tarc.core.errors import InvalidParameter
from tarc.plants.shapes import RobotGeometry
from tarc.simulation.run import Run
from tarc.studio.scene import RobotScene, robot_message, run_geometry, run_message
from tarc.studio.session import Session, in_thread


class ScenePanel:
    """Scene, or a line that says why there is none."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._client = ui.context.client
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

    async def _show(self, robot: str, run: Run) -> None:
        """Show a run of a robot."""
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
