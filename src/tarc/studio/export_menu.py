"""The menu that exports the design."""

from collections.abc import Awaitable, Callable

from nicegui import ui

from tarc.studio.jobs import JobError, first_result
from tarc.studio.session import Session

FILES = {
    "Scenario (YAML)": "design.yaml",
    "Law in C (ZIP)": "law.zip",
    "Law as FMU": "law.fmu",
    "Run (netCDF)": "run.nc",
    "Figure (PNG)": "runs.png",
    "Figure (PDF)": "runs.pdf",
}
"""What can be exported, with the name of its file."""


class ExportMenu:
    """A button with what can be exported."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with (
            ui.button("Export", icon="download").props('flat dense no-caps color=white aria-label="Export"'),
            ui.menu(),
        ):
            for label, name in FILES.items():
                ui.menu_item(label, on_click=self._writer(name))

    def _writer(self, name: str) -> Callable[[], Awaitable[None]]:
        async def write() -> None:
            session = self._session
            note = ui.notification(f"writing {name}", spinner=True, timeout=None)
            try:
                content = await first_result("tarc.studio.exports:send_file", name, session.state, session.robots)
            except JobError as error:
                ui.notify(str(error), type="negative", timeout=12000, close_button="Close")
                return
            finally:
                note.dismiss()
            ui.download.content(content, name)

        return write
