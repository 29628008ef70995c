"""From a robot and an encoder to certified gains."""

from tarc.core.optional import require

require("cli", "tarc.design")

from tarc.design.adaptation import Adaptation, choose_adaptation, expected_step
from tarc.design.candidates import Candidate, assess_candidates, enumerate_candidates, pareto_front
from tarc.design.choice import DesignChoice
from tarc.design.identification import Identified, excitation_reference, identify, inertia_from_data, inertia_from_file
from tarc.design.model_free import ModelFreeDesign, design_without_model
from tarc.design.requirements import DesignRequirements
from tarc.design.result import Design
from tarc.design.robustness import RobustnessSpec
from tarc.design.stress import StressLimit, StressRun, stress_test
from tarc.design.synthesis import design_controller

__all__ = [
    "Adaptation",
    "Candidate",
    "Design",
    "DesignChoice",
    "DesignRequirements",
    "Identified",
    "ModelFreeDesign",
    "RobustnessSpec",
    "StressLimit",
    "StressRun",
    "assess_candidates",
    "choose_adaptation",
    "design_controller",
    "design_without_model",
    "enumerate_candidates",
    "excitation_reference",
    "expected_step",
    "identify",
    "inertia_from_data",
    "inertia_from_file",
    "pareto_front",
    "stress_test",
]
