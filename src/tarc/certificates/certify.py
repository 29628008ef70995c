"""All certificates of a law on a robot at once."""

from collections.abc import Callable, Sequence
from contextlib import suppress

from tarc.certificates.ball import ball
from tarc.certificates.base import Certificate
from tarc.certificates.lemma1 import condition_c2, lemma1
from tarc.certificates.linear import alike, decouple
from tarc.certificates.loop import loop
from tarc.certificates.nominal import nominal
from tarc.certificates.robot import robot
from tarc.certificates.slope import slope
from tarc.certificates.theorem1 import theorem1
from tarc.certificates.theorem2 import theorem2
from tarc.certificates.workspace import Workspace
from tarc.errors import TarcError
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.poles import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.plants.base import Plant


def certify(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
    known: Certificate | None = None,
    done: Callable[[str], object] = lambda kind: None,
) -> dict[str, Certificate]:
    """All certificates that apply to a law on a robot, the verdict for the robot first.

    Parameters
    ----------
    law
        A law on time-delay estimation.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures that it takes.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Of the workspace.
    known
        What `robot` gave for all this, where it was asked before.
    done
        Called with the kind of each certificate once it is made, to show progress.

    Returns
    -------
    dict
        By kind. ``robot``; ``loop`` for every constant ratio that occurs; ``slope``, for TARC, at the one of the
        occurring ratios that bears least; ``ball``, the widest; then what the paper states: ``lemma1``, ``c2``,
        ``theorem1``, ``theorem2``, and ``nominal``, its second theorem repaired. Those that do not apply are left out.

    Raises
    ------
    TarcError
        For a law without an inertia, and as `robot` does.
    """
    if not isinstance(law, PolePlacement):
        raise TarcError(
            f"law: got {type(law).__name__}; certificates need a law with an inertia M̂, such as TDC or TARC"
        )
    found: dict[str, Certificate] = {}

    def add(certificate: Certificate) -> Certificate:
        found[certificate.kind] = certificate
        done(certificate.kind)
        return certificate

    options = {"computation_delay": computation_delay, "samples": samples, "seed": seed}
    verdict = add(known or robot(law, plant, workspace, **options))
    low, high = verdict.numbers["least ratio"], verdict.numbers["greatest ratio"]
    if all(channel.width == 1 for channel in decouple(law, computation_delay)):
        add(loop(law, (low, high), computation_delay=computation_delay))
    if isinstance(law, TARC):
        ratios = low, (low * high) ** 0.5, high
        occurring = [slope(law, ratio, computation_delay=computation_delay) for ratio in ratios]
        add(min(occurring, key=lambda one: one.numbers.get("circle limit", float("inf"))))
    if alike(law):
        with suppress(TarcError):  # stable for no ratio, which the verdict for the robot has shown already
            add(ball(law, computation_delay=computation_delay))
    add(lemma1(law, plant, workspace, samples=samples, seed=seed))
    if isinstance(law, TARC):
        add(condition_c2(law))
    if isinstance(law, TDE):
        add(theorem1(law))
        if isinstance(law.estimator, Algebraic):
            add(theorem2(law))
            add(nominal(law))
    return found
