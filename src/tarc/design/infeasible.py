"""The error of a design that nothing can meet, with the requirements to relax."""

from collections.abc import Sequence

from tarc.core.errors import InfeasibleDesign, Relaxation


def infeasible_design(reason: str, relaxations: Sequence[Relaxation]) -> InfeasibleDesign:
    """Return the error with a reason and the relaxations, each of which admits a design."""
    return InfeasibleDesign(f"{reason}. {_describe(relaxations)}", relaxations)


def _describe(relaxations: Sequence[Relaxation]) -> str:
    texts = [relaxation.text for relaxation in relaxations]
    if not texts:
        return "No change of a single requirement admits a design: add rotor inertia and reduce the workspace"
    if len(texts) == 1:
        return f"This change admits a design: {texts[0]}"
    return f"Any one of these changes admits a design: {'; '.join(texts)}"
