"""Conditions of the paper on the matrices alone: Lemma 1 on M̂ over a workspace, and condition (c2) on P."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tarc.analysis.inertia_ratio import extremes, inverse_ratios
from tarc.analysis.stability import Witness
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import FORMS, JUDGES, Certificate, dict_certificate
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.numerics.ball_arithmetic import balls, negative_at, positive, prove
from tarc.numerics.matrix_tests import definite
from tarc.plants.base import Plant


def check_lemma1(
    law: Law, plant: Plant | Sequence[Plant], workspace: Workspace, *, samples: int = 2000, seed: int = 0
) -> Certificate:
    """Test ‖M(q)⁻¹M̂ − I‖ < 1 over a workspace.

    For symmetric matrices it says that M M̂ + M̂ M − M̂² is positive definite, which is affine in M: where it holds for a
    robot without and with its payload, it holds for every payload between. It is decided at the worst posture found.

    Parameters
    ----------
    law
        A law on time-delay estimation; its M̂ is tested.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures.
    samples, seed
        How many postures to sample before a local search, and their seed.

    Returns
    -------
    Certificate
        Its margin is 1 less the largest norm found. Its numbers: that ``norm``, the least (``low``) and greatest
        (``high``) eigenvalue of M⁻¹M̂, and ``norm for M̂``, the largest of ‖E(q) − I‖ for E = M̂^½ M⁻¹ M̂^½, which is the
        same condition in coordinates that do not depend on units. Where refuted the witness is a posture.

    Raises
    ------
    TarcError
        For a law without an inertia, joints that do not match, and an M(q) that is singular somewhere.

    References
    ----------
    Paper, Lemma 1, (mass).
    """
    if not isinstance(law, PolePlacement):
        raise TarcError(f"law: got {type(law).__name__}; Lemma 1 is about M̂, so give a law on time-delay estimation")
    nominal, eye = law.M, np.eye(law.n_joints)
    robots = list(plant) if isinstance(plant, Sequence) else [plant]
    for robot in robots:
        if isinstance(robot, Plant) and robot.n_joints != law.n_joints:
            raise TarcError(f"law: it drives {law.n_joints} joints and the robot has {robot.n_joints}; give as many")
    worst, low, high = extremes(
        (
            lambda M: np.linalg.norm(np.linalg.solve(M, nominal) - eye, 2, axis=(1, 2)),
            lambda M: inverse_ratios(M, nominal)[:, -1],
            lambda M: -inverse_ratios(M, nominal)[:, 0],
        ),
        robots,
        workspace,
        samples=samples,
        seed=seed,
    )
    matrices = {"M": robots[worst.plant].inertia(worst.posture), "inertia": nominal, "position": worst.posture}
    verdict, margin, witness = judge_lemma1(matrices, {})
    ends = 1 / low.value, -1 / high.value
    return dict_certificate(
        kind="lemma1",
        claim="Lemma 1 of the paper holds: ‖M(q)⁻¹M̂ − I‖ < 1 at every posture of the workspace.",
        problem="M(q) M̂ + M̂ M(q) − M̂² > 0, the same for symmetric matrices",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the largest norm",
        assumptions=(
            f"the largest norm is the one found from {samples} postures and a local search; a larger one elsewhere is "
            "not excluded",
            "M(q) is the model's, computed in floating point",
            "the norm is that of the joints' own units; where they differ, the norm for M̂ among the numbers says more",
            "left out: the lemma bounds the estimation error for the true acceleration an instant ago. This law "
            "estimates the acceleration over a window, and its loop is stable only for far smaller ratios: see the "
            "certificates of the loop and of the ball",
        ),
        matrices=matrices,
        numbers={
            "norm": worst.value,
            "low": ends[0],
            "high": ends[1],
            "norm for M̂": max(abs(1 - end) for end in ends),
            "samples": float(samples),
            "plant": float(worst.plant),
        },
        witness=witness,
        proof_grade=verdict == "refuted",
    )


def judge_lemma1(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict, margin and witness at the stored posture; refuted only if proven in ball arithmetic."""
    M, nominal = matrices["M"], matrices["inertia"]
    norm = float(np.linalg.norm(np.linalg.solve(M, nominal) - np.eye(len(M)), 2))
    _, _, vector = definite(_lemma1_form(M, nominal))
    if prove(lambda: positive(_lemma1_form(balls(M), balls(nominal)))):
        return "certified", 1 - norm, None
    if prove(lambda: negative_at(_lemma1_form(balls(M), balls(nominal)), vector)):
        return "refuted", 1 - norm, {"position": matrices["position"].tolist(), "norm": norm}
    return "inconclusive", 1 - norm, None


def _lemma1_form(M: Array, nominal: Array) -> Array:
    """M² − (M̂ − M)²: with B = M⁻¹M̂ − I, I − BBᵀ multiplied by M from both sides."""
    return M @ nominal + nominal @ M - nominal @ nominal


def check_condition_c2(law: Law) -> Certificate:
    """Test condition (c2), P3 P2ᵀ > 0 (its symmetric part), for the P of a law.

    P is known in floating point, and so solves its Lyapunov equation for a Q a little off. The paper asks for some
    Q > 0; that P > 0, AᵀP + PA < 0 and (c2) hold for the very P in use is decided in ball arithmetic.

    Returns
    -------
    Certificate
        Its margin is the least eigenvalue of (P3 P2ᵀ + P2 P3)/2 over the greatest. Its numbers: the relative
        ``residual`` of the Lyapunov equation; ``shrinking``, the value of Δsᵀs = ė1ᵀ P3 P2 e1 at ``e1`` and ė1 = −e1 of
        the matrices, an error that shrinks; and where P3 P2 and P2ᵀP2 are not parallel, ``growing``, its value at the
        unit ``f1`` and ``df1``, where ‖s‖ grows. Both are negative: (c2) does not give Δsᵀs > 0.

    Raises
    ------
    TarcError
        For a law without a P.

    References
    ----------
    Paper, (c2), and (new 1) in the proof of Theorem 2, which does not follow from it.
    """
    if not isinstance(law, TARC):
        raise TarcError(f"law: got {type(law).__name__}; condition (c2) is about the P of tarc.laws.TARC")
    matrices = {"A": law.A, "P": law.P, "Q": law.Q, **_counterexamples(law)}
    verdict, margin, witness = judge_c2(matrices, {})
    residual = np.linalg.norm(law.A.T @ law.P + law.P @ law.A + law.Q, 2) / np.linalg.norm(law.Q, 2)
    product = law.P3 @ law.P2
    numbers = {"residual": float(residual), "shrinking": float(-matrices["e1"] @ product @ matrices["e1"])}
    if "f1" in matrices:
        numbers["growing"] = float(matrices["df1"] @ product @ matrices["f1"])
    return dict_certificate(
        kind="c2",
        claim="Condition (c2) of the paper holds: P3 P2ᵀ is positive definite.",
        problem="P > 0, AᵀP + PA < 0, P3 P2ᵀ + P2 P3 > 0",
        verdict=verdict,
        margin=margin,
        margin_meaning="least over greatest eigenvalue of the symmetric part of P3 P2ᵀ",
        assumptions=(
            "gains and P are the floating-point numbers that the law runs with",
            "left out: the paper concludes Δsᵀs > 0 from it, but Δsᵀs = ė1ᵀ P3 P2 e1 is negative where the error "
            "shrinks as from the stored e1 at ė1 = −e1",
        ),
        matrices=matrices,
        numbers=numbers,
        witness=witness,
        proof_grade=verdict != "inconclusive",
    )


def judge_c2(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict, margin and witness from A and P, in ball arithmetic."""
    A, P = matrices["A"], matrices["P"]
    values, vectors = np.linalg.eigh(_c2_form(P))
    margin = float(values[0] / max(np.max(np.abs(values)), 1e-300))

    def holds() -> bool:
        a, p = balls(A), balls(P)
        return positive(p) and positive(-(a.T @ p + p @ a)) and positive(_c2_form(p))

    if prove(holds):
        return "certified", margin, None
    if prove(lambda: negative_at(_c2_form(balls(P)), vectors[:, 0])):
        return "refuted", margin, {"vector": vectors[:, 0].tolist()}
    return "inconclusive", margin, None


def _c2_form(P: Array) -> Array:
    """Symmetric part of P3 P2ᵀ."""
    n = len(P) // 2
    product = P[n:, n:] @ P[n:, :n].T
    return (product + product.T) / 2


def _c2_forms(matrices: dict[str, Array], _: dict[str, Any]) -> dict[str, Array]:
    A, P = matrices["A"], matrices["P"]
    return {"P": P, "−(AᵀP + PA)": -(A.T @ P + P @ A), "P3 P2ᵀ": _c2_form(P)}


def _counterexamples(law: TARC) -> dict[str, Array]:
    """Errors and their rates at which Δsᵀs < 0: e1 with −e1, which shrinks, and f1 with df1, where ‖s‖ grows."""
    product, growth = law.P3 @ law.P2, law.P2.T @ law.P2
    # the trace of P3 P2 is that of P3 P2ᵀ, positive under (c2), so that the top eigenvalue is
    top = np.linalg.eigh((product + product.T) / 2)[1][:, -1]
    found = {"e1": top}
    for e1 in np.eye(law.n_joints):
        ahead, behind = growth @ e1 / np.linalg.norm(growth @ e1), product @ e1 / np.linalg.norm(product @ e1)
        if np.linalg.norm(ahead - behind) > 1e-6:
            found |= {"f1": e1, "df1": (ahead - behind) / np.linalg.norm(ahead - behind)}
            break
    return found


JUDGES["lemma1"] = judge_lemma1
JUDGES["c2"] = judge_c2
FORMS["lemma1"] = lambda matrices, _: {"M M̂ + M̂ M − M̂²": _lemma1_form(matrices["M"], matrices["inertia"])}
FORMS["c2"] = _c2_forms
