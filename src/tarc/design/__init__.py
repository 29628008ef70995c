"""From a robot and an encoder to certified gains."""

from tarc.design.adaptation import Adaptation, adaptation, expected_step
from tarc.design.blind import BlindDesign, design_from_inertia
from tarc.design.choose import Choice, Design, design
from tarc.design.demand import Demand
from tarc.design.front import Candidate, assess, candidates, front
from tarc.design.identify import Identified, excitation, identify, inertia_from_data, inertia_from_file
from tarc.design.limits import Limit, Outcome, limits
from tarc.design.procedure import Procedure, Step, paper_procedure

__all__ = [
    "Adaptation",
    "BlindDesign",
    "Candidate",
    "Choice",
    "Demand",
    "Design",
    "Identified",
    "Limit",
    "Outcome",
    "Procedure",
    "Step",
    "adaptation",
    "assess",
    "candidates",
    "design",
    "design_from_inertia",
    "excitation",
    "expected_step",
    "front",
    "identify",
    "inertia_from_data",
    "inertia_from_file",
    "limits",
    "paper_procedure",
]
