"""From a robot and an encoder to certified gains."""

from typing import TYPE_CHECKING

from tarc.core.lazy import lazy_attributes
from tarc.core.optional import require

require("cli", "tarc.design")

if TYPE_CHECKING:
    from tarc.design.adaptation import Adaptation, choose_adaptation, expected_step
    from tarc.design.assessment import assess_candidates
    from tarc.design.candidates import Candidate, enumerate_candidates, pareto_front
    from tarc.design.choice import DesignChoice
    from tarc.design.excitation import excitation_reference
    from tarc.design.identification import IdentifiedInertia, inertia_from_data, inertia_from_file
    from tarc.design.model_free import ModelFreeDesign, design_without_model
    from tarc.design.requirements import DesignRequirements
    from tarc.design.result import Design
    from tarc.design.robot_identification import identify
    from tarc.design.robustness import RobustnessSpec
    from tarc.design.stress import StressLimit, predict_design_error, stress_test, try_design
    from tarc.design.stress_case import StressRun
    from tarc.design.synthesis import design_controller

__all__ = [
    "Adaptation",
    "Candidate",
    "Design",
    "DesignChoice",
    "DesignRequirements",
    "IdentifiedInertia",
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
    "predict_design_error",
    "stress_test",
    "try_design",
]

__getattr__, __dir__, _ = lazy_attributes(
    __name__,
    {
        "Adaptation": "tarc.design.adaptation",
        "Candidate": "tarc.design.candidates",
        "Design": "tarc.design.result",
        "DesignChoice": "tarc.design.choice",
        "DesignRequirements": "tarc.design.requirements",
        "IdentifiedInertia": "tarc.design.identification",
        "ModelFreeDesign": "tarc.design.model_free",
        "RobustnessSpec": "tarc.design.robustness",
        "StressLimit": "tarc.design.stress",
        "StressRun": "tarc.design.stress_case",
        "assess_candidates": "tarc.design.assessment",
        "choose_adaptation": "tarc.design.adaptation",
        "design_controller": "tarc.design.synthesis",
        "design_without_model": "tarc.design.model_free",
        "enumerate_candidates": "tarc.design.candidates",
        "excitation_reference": "tarc.design.excitation",
        "expected_step": "tarc.design.adaptation",
        "identify": "tarc.design.robot_identification",
        "inertia_from_data": "tarc.design.identification",
        "inertia_from_file": "tarc.design.identification",
        "pareto_front": "tarc.design.candidates",
        "stress_test": "tarc.design.stress",
        "predict_design_error": "tarc.design.stress",
        "try_design": "tarc.design.stress",
    },
)
