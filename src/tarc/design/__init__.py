"""From a robot and an encoder to certified gains."""

from tarc.core.optional import require

require("cli", "tarc.design")

from tarc.design.adaptation_gains import Adaptation, adaptation, expected_step
from tarc.design.candidate_loops import Candidate, assess, candidates, front
from tarc.design.identification import Identified, excitation, identify, inertia_from_data, inertia_from_file
from tarc.design.model_free import BlindDesign, design_from_inertia
from tarc.design.robustness import Demand
from tarc.design.selection import Choice, Design, design
from tarc.design.stress import Limit, Outcome, limits

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
]
