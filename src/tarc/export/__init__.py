"""Laws as C99 that runs anywhere, and the proof that it is the same law."""

from typing import TYPE_CHECKING

from tarc.core.lazy import lazy_attributes

if TYPE_CHECKING:
    from tarc.export.c_project import Export, export_c
    from tarc.export.fmu import Fmu, export_fmu
    from tarc.export.ros2 import export_ros2
    from tarc.export.verification import ExportReport, verify_export

__all__ = ["Export", "ExportReport", "Fmu", "export_c", "export_fmu", "export_ros2", "verify_export"]

__getattr__, __dir__, _ = lazy_attributes(
    __name__,
    {
        "Export": "tarc.export.c_project",
        "ExportReport": "tarc.export.verification",
        "Fmu": "tarc.export.fmu",
        "export_c": "tarc.export.c_project",
        "export_fmu": "tarc.export.fmu",
        "export_ros2": "tarc.export.ros2",
        "verify_export": "tarc.export.verification",
    },
)
