"""The page: header with tabs, and the Design tab with its three columns."""

from collections.abc import Callable
from pathlib import Path

from fastapi import Request
from nicegui import Client, events, ui

from tarc.studio.access import SessionFolders
from tarc.studio.controls import ControlPanel
from tarc.studio.design_state import DesignState
from tarc.studio.export_menu import ExportMenu
from tarc.studio.live_tab import LiveTab
from tarc.studio.loop_panel import CertificatePanel, LoopPanel
from tarc.studio.robots import Robots
from tarc.studio.run_panel import RunPanel
from tarc.studio.scene_panel import ScenePanel
from tarc.studio.session import Session
from tarc.studio.study_tab import StudyTab
from tarc.studio.upload_panel import UploadPanel

STYLE = (Path(__file__).parent / "studio.css").read_text(encoding="utf-8")
DOT = (Path(__file__).parent / "map_dot.js").read_text(encoding="utf-8")
HIDDEN_PLOTS = """<script>addEventListener("unhandledrejection", (event) => {
  if (String(event.reason).includes("displayed plot div")) event.preventDefault();
});</script>"""
"""Plots of a tab that is not shown refuse to be resized; they are when it is shown."""
MAX_NOTES = 6
"""Notes of a scenario that are shown."""


def add_pages(robots: Robots, start: DesignState, notes: list[str], folders: SessionFolders) -> None:
    """Register the page.

    Parameters
    ----------
    robots
        Robots that every session offers.
    start
        The design of a session whose URL says nothing else.
    notes
        What the page left out of the scenario of that design.
    folders
        Of the sessions.
    """

    @ui.page("/", title="tarc studio")
    async def studio(request: Request, client: Client) -> None:
        state, unknown = DesignState.from_query(str(request.url.query), start)
        if state.robot not in robots.labels:
            unknown = [*unknown, f"robot={state.robot}: not offered here"]
            state = state.with_changes(robot=start.robot)
        session = Session(robots.copy(), state, [*notes, *unknown])
        folder = folders.create()
        client.on_delete(session.close)
        client.on_delete(lambda: folders.remove(folder))
        ui.add_css(STYLE)
        ui.add_head_html(f"{HIDDEN_PLOTS}<script>{DOT}</script>")
        build_page(session, folder)
        await client.connected()
        session.start()


def build_page(session: Session, folder: Path) -> None:
    """Build the page of a session."""
    ui.colors(primary="#0072b2")
    dark = ui.dark_mode(None)
    with ui.header().classes("studio-header items-center no-wrap"):
        ui.label("tarc studio").classes("studio-title").props("role=heading aria-level=1")
        with ui.tabs().props("dense no-caps inline-label") as tabs:
            design_tab = ui.tab("Design")
            study_tab = ui.tab("Study")
            live_tab = ui.tab("Live")
        ui.space()
        ExportMenu(session)
        HistoryButtons(session)
        icon_button("contrast", "Light or dark", lambda: _switch_theme(dark))
    panels = ui.tab_panels(tabs, value=design_tab).classes("w-full studio-panels").props("keep-alive")
    with panels, ui.tab_panel(design_tab).classes("p-0"):
        build_design_tab(session, folder)
    with panels, ui.tab_panel(study_tab).classes("p-0"):
        StudyTab(session)
    with panels, ui.tab_panel(live_tab).classes("p-0"):
        LiveTab(session)
    follow_in_url(session)
    ui.keyboard(on_key=lambda event: _on_key(event, session), ignore=[])
    if session.notes:
        ui.notify("Left out: " + "; ".join(session.notes[:MAX_NOTES]), timeout=12000, close_button="Close")


def build_design_tab(session: Session, folder: Path) -> None:
    """Build the left, middle and right columns."""
    with ui.element("div").classes("columns"):
        with ui.element("section").classes("pane").props('aria-label="Design"'):
            ControlPanel(session)
            UploadPanel(session, folder)
        with ui.element("section").classes("pane").props('aria-label="Loop and certificates"'):
            LoopPanel(session)
            CertificatePanel(session)
        with ui.element("section").classes("pane").props('aria-label="Runs"'):
            RunPanel(session)
            ScenePanel(session)


class HistoryButtons:
    """Undo and redo."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._undo = icon_button("undo", "Undo", session.undo)
        self._redo = icon_button("redo", "Redo", session.redo)
        session.listen("state", self.update)
        self.update()

    def update(self) -> None:
        """Enable what can be done."""
        self._undo.set_enabled(self._session.history.can_undo)
        self._redo.set_enabled(self._session.history.can_redo)


def icon_button(icon: str, label: str, on_click: Callable[[], object]) -> ui.button:
    """Return a round button with a label for screen readers."""
    button = ui.button(icon=icon, on_click=on_click).props(f'flat round dense color=white aria-label="{label}"')
    return button.tooltip(label)


def follow_in_url(session: Session) -> None:
    """Keep the design in the URL of the browser."""

    def write() -> None:
        query = session.state.to_query()
        ui.navigate.history.replace(f"?{query}" if query else "?")

    client = ui.context.client

    def write_in_client() -> None:
        with client:
            write()

    session.listen("state", write_in_client)


def _switch_theme(dark: ui.dark_mode) -> None:
    dark.value = {None: True, True: False, False: None}[dark.value]


def _on_key(event: events.KeyEventArguments, session: Session) -> None:
    """Undo for Ctrl+Z, redo for Ctrl+Y and Ctrl+Shift+Z."""
    if not event.action.keydown or not (event.modifiers.ctrl or event.modifiers.meta):
        return
    key = event.key.name.lower()
    if key == "y" or (key == "z" and event.modifiers.shift):
        session.redo()
    elif key == "z":
        session.undo()
