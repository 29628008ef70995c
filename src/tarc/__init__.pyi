from . import certificates, design, estimators, laws, plants, signals, study
from .controller import Controller
from .errors import DesignWarning, TarcError
from .loop import simulate
from .run import Run, Status
from .scenario import Scenario
from .version import __version__

__all__ = [
    "Controller",
    "DesignWarning",
    "Run",
    "Scenario",
    "Status",
    "TarcError",
    "__version__",
    "certificates",
    "design",
    "estimators",
    "laws",
    "plants",
    "signals",
    "simulate",
    "study",
]
