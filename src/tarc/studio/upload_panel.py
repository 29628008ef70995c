"""Upload of a robot: the button of the page, and the motion that its robot gets."""

import asyncio
from pathlib import Path
from typing import Any

from nicegui import events, ui

from tarc.core.errors import RobotFileError
from tarc.studio.session import Session
from tarc.studio.upload import UploadedRobot, read_upload
from tarc.studio.upload_files import UploadLimits

DURATION = 3.0
"""Of the motion of an uploaded robot [s]."""
ARMATURE = 0.1
"""Rotor inertia of each joint where the user gives none [kg m²]."""


class UploadPanel:
    """Field that takes a robot, the rotor inertia of its joints, and the error of the last upload.

    Parameters
    ----------
    session
        That gets the robot.
    folder
        Of the session.
    """

    def __init__(self, session: Session, folder: Path) -> None:
        self._session = session
        self._folder = folder
        limits = UploadLimits()
        with ui.expansion("Upload a robot").classes("w-full").props("dense").mark("upload-panel"):
            self._armature = ui.number("Rotor inertia of each joint [kg m²]", value=ARMATURE, min=0, step=0.01)
            self._armature.props('dense outlined aria-label="Rotor inertia of each joint [kg m²]"').classes("w-full")
            self._field = ui.upload(
                label="URDF or MJCF, with meshes or as zip",
                multiple=True,
                auto_upload=True,
                max_total_size=limits.size,
                max_files=limits.n_files,
                on_multi_upload=self._read,
                on_rejected=lambda: self._show(f"upload: needs at most {limits.size >> 20} MB"),
            )
            self._field.props("flat bordered dense").classes("w-full").mark("upload")
        # outside the expansion, so that a message is read even where that is closed
        self._message = (
            ui.label().classes("upload-message").props("role=status aria-live=polite").mark("upload-message")
        )

    async def _read(self, event: events.MultiUploadEventArguments) -> None:
        """Read the uploaded files and offer their robot."""
        files = {file.name: await file.read() for file in event.files}
        self._show("Reading the robot …")
        options = {} if self._armature.value is None else {"armature": float(self._armature.value)}
        try:
            robot = await asyncio.to_thread(self._read_files, files, options)
        except RobotFileError as error:
            self._show(str(error))
            return
        finally:
            self._field.reset()
        name = robot.file.relative_to(self._folder).parts[0]  # of its upload, since many have a folder "urdf"
        self._session.robots.add(name, f"{robot.file.stem} (uploaded)", scenario_content(robot, options))
        self._show("; ".join([f"{robot.file.name}: {len(robot.joint_names)} joints", *robot.warnings]))
        self._session.change(robot=name, payload=0.0)

    def _read_files(self, files: dict[str, bytes], options: dict[str, Any]) -> UploadedRobot:
        return read_upload(files, self._folder, options=options)

    def _show(self, message: str) -> None:
        self._message.set_text(message)


def scenario_content(robot: UploadedRobot, options: dict[str, Any]) -> dict[str, Any]:
    """Return robot, motion and duration of an uploaded robot as the content of a scenario."""
    return {
        "name": robot.file.stem,
        "robot": {"file": str(robot.file), **options},
        "reference": {
            "kind": "Sinusoid",
            "amplitude": list(robot.amplitudes),
            "frequency": [1.0 + 0.3 * joint for joint in range(len(robot.joint_names))],
            "phase": 1.5707963267948966,  # starts at an extreme, at rest
            "offset": list(robot.offsets),
        },
        "sensor": {"bits": 17},
        "initial_torque": "rest",
        "duration": DURATION,
    }
