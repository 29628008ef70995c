"""From a robot and an encoder to certified gains."""

from tarc.design.adaptation import Adaptation, adaptation, expected_step
from tarc.design.choose import Choice, Design, design
from tarc.design.front import Candidate, assess, candidates, front

__all__ = [
    "Adaptation",
    "Candidate",
    "Choice",
    "Design",
    "adaptation",
    "assess",
    "candidates",
    "design",
    "expected_step",
    "front",
]
