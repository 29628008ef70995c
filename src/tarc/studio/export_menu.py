"""The menu that exports the design."""

from collections.abc import Awaitable, Callable

from nicegui import ui

from tarc.studio.jobs import DESIGN_ERRORS
from tarc.studio.session import Session, in_thread

LABELS = ("Scenario (YAML)", "Law in C (ZIP)", "Law as FMU", "Run (netCDF)", "Figure (PNG)", "Figure (PDF)")


class ExportMenu:
    """A button with what can be exported."""

    def __init__(self, session: Session) -> None:
        self._session = session
        with (
            ui.button("Export", icon="download").props('flat dense no-caps color=white aria-label="Export"'),
            ui.menu(),
        ):
            for label in LABELS:
                ui.menu_item(label, on_click=self._writer(label))

    def _writer(self, label: str) -> Callable[[], Awaitable[None]]:
        async def write() -> None:
            from tarc.studio.exports import writers

            session = self._session
            files = writers(session.state, session.robots, session.results.runs)
            if label not in files:
                ui.notify("The run is not there yet", type="warning")
                return
            name, make = files[label]
            try:
                content = await in_thread(make)
            except DESIGN_ERRORS as error:
                ui.notify(str(error), type="negative", timeout=12000, close_button="Close")
                return
            ui.download.content(content, name)

        return write
