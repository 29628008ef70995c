"""Robot tracking from position measurements alone: time-delayed adaptive robust control.

``tarc.laws``, ``tarc.estimators``, ``tarc.plants``, ``tarc.signals`` hold the parts; `simulate` runs them, and
`Controller` runs a law on a robot of your own.
"""

from typing import TYPE_CHECKING

from tarc.core.lazy import lazy_attributes

if TYPE_CHECKING:
    from tarc import analysis, certificates, design, estimators, export, laws, paper, plants, runtime, signals, study
    from tarc.certification import certify_law
    from tarc.control.controller import Controller
    from tarc.control.watch import Watch, Watcher, WatchFlag
    from tarc.core.errors import DesignWarning, JointLimitWarning, MissingTool, RobotFileWarning, TarcError
    from tarc.core.version import __version__
    from tarc.laws.nominal_inertia import Feedforward, NominalInertia
    from tarc.logs.diagnosis import Diagnosis, diagnose
    from tarc.logs.findings import Finding
    from tarc.logs.identified_model import IdentifiedModel, identify_model, inertia_from_log
    from tarc.logs.replayed import Replay, replay
    from tarc.scenario.cartesian import CartesianWaypoints
    from tarc.scenario.model import Scenario
    from tarc.simulation.run import Run, Status
    from tarc.simulation.simulator import simulate

__all__ = [
    "CartesianWaypoints",
    "Controller",
    "DesignWarning",
    "Diagnosis",
    "Feedforward",
    "Finding",
    "IdentifiedModel",
    "JointLimitWarning",
    "MissingTool",
    "NominalInertia",
    "Replay",
    "RobotFileWarning",
    "Run",
    "Scenario",
    "Status",
    "TarcError",
    "Watch",
    "WatchFlag",
    "Watcher",
    "__version__",
    "analysis",
    "certificates",
    "certify_law",
    "design",
    "diagnose",
    "estimators",
    "export",
    "identify_model",
    "inertia_from_log",
    "laws",
    "paper",
    "plants",
    "replay",
    "runtime",
    "signals",
    "simulate",
    "study",
]

__getattr__, __dir__, _ = lazy_attributes(
    __name__,
    {
        "CartesianWaypoints": "tarc.scenario.cartesian",
        "Controller": "tarc.control.controller",
        "DesignWarning": "tarc.core.errors",
        "Diagnosis": "tarc.logs.diagnosis",
        "Finding": "tarc.logs.findings",
        "diagnose": "tarc.logs.diagnosis",
        "Feedforward": "tarc.laws.nominal_inertia",
        "NominalInertia": "tarc.laws.nominal_inertia",
        "JointLimitWarning": "tarc.core.errors",
        "RobotFileWarning": "tarc.core.errors",
        "MissingTool": "tarc.core.errors",
        "IdentifiedModel": "tarc.logs.identified_model",
        "identify_model": "tarc.logs.identified_model",
        "inertia_from_log": "tarc.logs.identified_model",
        "Replay": "tarc.logs.replayed",
        "Run": "tarc.simulation.run",
        "Scenario": "tarc.scenario.model",
        "Status": "tarc.simulation.run",
        "TarcError": "tarc.core.errors",
        "Watch": "tarc.control.watch",
        "WatchFlag": "tarc.control.watch",
        "Watcher": "tarc.control.watch",
        "__version__": "tarc.core.version",
        "certify_law": "tarc.certification",
        "replay": "tarc.logs.replayed",
        "simulate": "tarc.simulation.simulator",
    },
    (
        "analysis",
        "certificates",
        "design",
        "estimators",
        "export",
        "laws",
        "paper",
        "plants",
        "runtime",
        "signals",
        "study",
    ),
)
