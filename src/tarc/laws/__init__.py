"""Control laws that see positions and the reference alone."""

from tarc.laws.adrc import ADRC
from tarc.laws.asmc import ASMC
from tarc.laws.barrier import BarrierTDARC
from tarc.laws.base import Law, LawInput, LawOutput
from tarc.laws.computed_torque import ComputedTorque
from tarc.laws.corless_leitmann import CorlessLeitmann
from tarc.laws.fuzzy import AdaptiveFuzzy
from tarc.laws.ideal_velocity import IVF
from tarc.laws.intelligent_pid import IntelligentPID
from tarc.laws.internal_model import TDCIM
from tarc.laws.model_based import ModelBased
from tarc.laws.monotone import MonotoneASMC
from tarc.laws.nonsingular import NonsingularTerminal
from tarc.laws.pid import PID
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.projection import ProjectionARC
from tarc.laws.sliding import SlidingMode
from tarc.laws.super_twisting import SuperTwisting
from tarc.laws.switching import Switching
from tarc.laws.tarc import TARC
from tarc.laws.tdarc import TDARC
from tarc.laws.tdc import TDC
from tarc.laws.tde import TDE
from tarc.laws.terminal import TerminalSliding

__all__ = [
    "ADRC",
    "ASMC",
    "IVF",
    "PID",
    "TARC",
    "TDARC",
    "TDC",
    "TDCIM",
    "TDE",
    "AdaptiveFuzzy",
    "BarrierTDARC",
    "ComputedTorque",
    "CorlessLeitmann",
    "IntelligentPID",
    "Law",
    "LawInput",
    "LawOutput",
    "ModelBased",
    "MonotoneASMC",
    "NonsingularTerminal",
    "PolePlacement",
    "ProjectionARC",
    "SlidingMode",
    "SuperTwisting",
    "Switching",
    "TerminalSliding",
]
