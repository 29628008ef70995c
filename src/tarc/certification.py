"""All certificates of a law on a robot at once."""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from tarc.analysis.linearise import alike, decouple
from tarc.analysis.rest_stability import remedy
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Evidence, certificate_from_plain
from tarc.certificates.constant_ratio import certify_constant_ratio
from tarc.certificates.robot import certify_robot
from tarc.certificates.sector import certify_sector
from tarc.certificates.varying_ratio import certify_varying_ratio
from tarc.core.errors import TarcError
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.paper.lemma1 import ConditionC2Evidence, Lemma1Evidence, check_condition_c2, check_lemma1
from tarc.paper.nominal_loop import NominalEvidence, check_nominal_loop
from tarc.paper.theorem1 import Theorem1Evidence, check_theorem1
from tarc.paper.theorem2 import Theorem2Evidence, check_theorem2
from tarc.plants.base import Plant


def certify_law(
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
    verdict = add(known or certify_robot(law, plant, workspace, **options))
    low, high = verdict.numbers["least ratio"], verdict.numbers["greatest ratio"]
    if all(channel.width == 1 for channel in decouple(law, computation_delay)):
        add(certify_constant_ratio(law, (low, high), computation_delay=computation_delay))
    if isinstance(law, TARC):
        ratios = low, (low * high) ** 0.5, high
        occurring = [certify_sector(law, ratio, computation_delay=computation_delay) for ratio in ratios]
        add(min(occurring, key=lambda one: one.numbers.get("circle limit", float("inf"))))
    if alike(law):
        with suppress(TarcError):  # stable for no ratio, which the verdict for the robot has shown already
            add(certify_varying_ratio(law, computation_delay=computation_delay))
    add(check_lemma1(law, plant, workspace, samples=samples, seed=seed))
    if isinstance(law, TARC):
        add(check_condition_c2(law))
    if isinstance(law, TDE):
        add(check_theorem1(law))
        if isinstance(law.estimator, Algebraic):
            add(check_theorem2(law))
            add(check_nominal_loop(law))
    return found


def advice(law: PolePlacement, verdict: Certificate, computation_delay: int = 0) -> str:
    """What to change in a design that was not certified, with numbers; empty for one that was."""
    if verdict.witness:
        return remedy(law, verdict.witness, computation_delay)
    if verdict.certified:
        return ""
    if not alike(law):
        return "Give all joints the same natural frequency and damping, which the ball needs"
    if isinstance(law, TARC) and law.max_gain is None:
        return "Give the gain a cap, without which nothing bounds the robust term"
    if not np.isfinite(law.robust_slope_bound):
        return "The robust term of this law is not covered by these certificates: simulate it"
    needed, slope, rate = verdict.numbers["spread"], verdict.numbers["slope"], verdict.numbers.get("rate")
    slower = "a bound on the joints' speeds" if rate is None else "slower joints"
    trials = {"as it is": law}
    if isinstance(law, TDE) and not law.synchronised:
        trials["synchronised"] = replace(law, synchronised=True, delay=None)
    lines = []
    for name, trial in trials.items():
        with suppress(TarcError):
            found = certify_varying_ratio(trial, slope=slope, rate=rate, computation_delay=computation_delay).numbers
            scale = (found["low"] * found["high"]) ** 0.5
            scale /= (verdict.numbers["least ratio"] * verdict.numbers["greatest ratio"]) ** 0.5
            lines.append(f"{found['ratio']:.3g} ({name}, with {scale:.3g} of this M̂)")
    return (
        f"The robot's spread is {needed:.3g}; the widest ball of this loop holds {' or '.join(lines) or 'none'}. A "
        f"shorter window, a lower natural frequency, a smaller cap, more rotor inertia or {slower} narrow the gap; "
        "inconclusive does not mean unstable"
    )


def _evidence_types() -> dict[str, type[Evidence]]:
    """Return the class of evidence of each kind of certificate."""
    classes = (
        Lemma1Evidence,
        ConditionC2Evidence,
        Theorem1Evidence,
        Theorem2Evidence,
        NominalEvidence,
    )
    return {evidence_type.kind: evidence_type for evidence_type in classes}


def certificate_from_dict(content: dict[str, Any]) -> Certificate:
    """Return the certificate that `Certificate.to_dict` wrote.

    Raises
    ------
    TarcError
        For content that is no certificate.
    """
    try:
        evidence_type = _evidence_types().get(content["kind"])
        if evidence_type is None:
            return Certificate.from_json(json.dumps(content))
        return certificate_from_plain(evidence_type, content, content["evidence"])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise TarcError(f"certificate: cannot read it ({error}); needs what Certificate.to_dict wrote") from None


def certificate_from_json(text: str) -> Certificate:
    """Return the certificate that `Certificate.to_json` wrote.

    Raises
    ------
    TarcError
        For text that is no certificate.
    """
    try:
        content = json.loads(text)
    except ValueError as error:
        raise TarcError(f"certificate: the text is no JSON ({error}); needs what Certificate.to_json wrote") from None
    return certificate_from_dict(content)
