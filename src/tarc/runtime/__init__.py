"""The loop on the machine: a law at absolute deadlines on a robot, with limits, a safe stop and a log."""

from typing import TYPE_CHECKING

from tarc.core.lazy import lazy_attributes

if TYPE_CHECKING:
    from tarc.runtime.clock import Clock, SimulatedClock
    from tarc.runtime.dds import DdsRobot
    from tarc.runtime.gain_changes import GainChanges
    from tarc.runtime.iosys import to_iosys
    from tarc.runtime.law_environment import LawEnvironment
    from tarc.runtime.limits import SafetyLimits
    from tarc.runtime.live_loop import StartUp
    from tarc.runtime.live_run import LiveRun, run_live
    from tarc.runtime.mujoco_robot import MujocoRobot
    from tarc.runtime.online import OnlineReference
    from tarc.runtime.packet_robot import PacketRobot, udp_robot
    from tarc.runtime.plant_robot import PlantRobot
    from tarc.runtime.push import Push, PushResponse
    from tarc.runtime.robot import Robot

__all__ = [
    "Clock",
    "DdsRobot",
    "GainChanges",
    "LawEnvironment",
    "LiveRun",
    "MujocoRobot",
    "OnlineReference",
    "PacketRobot",
    "PlantRobot",
    "Push",
    "PushResponse",
    "Robot",
    "SafetyLimits",
    "SimulatedClock",
    "StartUp",
    "run_live",
    "to_iosys",
    "udp_robot",
]

__getattr__, __dir__, _ = lazy_attributes(
    __name__,
    {
        "Clock": "tarc.runtime.clock",
        "DdsRobot": "tarc.runtime.dds",
        "GainChanges": "tarc.runtime.gain_changes",
        "LawEnvironment": "tarc.runtime.law_environment",
        "LiveRun": "tarc.runtime.live_run",
        "MujocoRobot": "tarc.runtime.mujoco_robot",
        "OnlineReference": "tarc.runtime.online",
        "PacketRobot": "tarc.runtime.packet_robot",
        "PlantRobot": "tarc.runtime.plant_robot",
        "Push": "tarc.runtime.push",
        "PushResponse": "tarc.runtime.push",
        "Robot": "tarc.runtime.robot",
        "SafetyLimits": "tarc.runtime.limits",
        "SimulatedClock": "tarc.runtime.clock",
        "StartUp": "tarc.runtime.live_loop",
        "run_live": "tarc.runtime.live_run",
        "to_iosys": "tarc.runtime.iosys",
        "udp_robot": "tarc.runtime.packet_robot",
    },
)
