"""Control laws that see positions and the reference alone."""

from tarc.laws.base import Law, LawInput, LawOutput
from tarc.laws.poles import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.laws.tde import TDE

__all__ = ["TARC", "TDC", "TDE", "Law", "LawInput", "LawOutput", "PolePlacement"]
