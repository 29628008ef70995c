"""Conditions of the paper on the matrices alone: Lemma 1 on M̂ over a workspace, and condition (c2) on P."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import (
    InertiaFunction,
    InertiaSpread,
    as_plants,
    inertia_spread,
    maximise_over_workspace,
)
from tarc.analysis.known_inertia import KnownInertia, worst_points
from tarc.analysis.operating_points import OperatingPoint
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Evidence, Judgement, Verdict
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.numerics.ball_arithmetic import balls, decide, is_negative_at, is_positive_definite
from tarc.numerics.matrix_tests import definiteness
from tarc.paper.tde_error import contraction_norms, delay_periods, largest_point
from tarc.plants.base import Plant


@dataclass(frozen=True, kw_only=True, eq=False)
class Lemma1Witness:
    """A posture at which Lemma 1 fails.

    Attributes
    ----------
    posture
        q, shape (n,) [rad or m].
    norm
        ‖M(q)⁻¹M̂ − I‖ there.
    """

    posture: Array
    norm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Lemma1Evidence(Evidence):
    """The worst posture for Lemma 1, and the inertia ratios of the workspace.

    Attributes
    ----------
    inertia, nominal_inertia
        M(q) at the posture, and M̂, each (n, n).
    posture
        The posture with the largest norm, shape (n,) [rad or m].
    norm
        ‖M(q)⁻¹M̂ − I‖ at the posture, in the joints' own units.
    scaled_norm
        Largest ‖E(q) − I‖ with E = M̂^½ M⁻¹ M̂^½, the same condition in coordinates that do not depend on units. For
        M̂(q) these coordinates move, and it includes the factor e^{r h/2} for the rate r of M̂ and the delay h.
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̂ over the workspace.
    samples
        Number of sampled postures.
    plant_index
        Index of the plant with the largest norm.
    """

    kind: ClassVar[str] = "lemma1"
    witness_type: ClassVar[type[Lemma1Witness]] = Lemma1Witness

    inertia: Array
    nominal_inertia: Array
    posture: Array
    norm: float
    scaled_norm: float
    min_ratio: float
    max_ratio: float
    samples: int
    plant_index: int

    def judge(self) -> Judgement:
        """Return the verdict at the stored posture, in ball arithmetic."""
        M, nominal = self.inertia, self.nominal_inertia
        norm = float(np.linalg.norm(np.linalg.solve(M, nominal) - np.eye(len(M)), 2))
        _, _, vector = definiteness(lemma1_form(M, nominal))
        if decide(lambda: is_positive_definite(lemma1_form(balls(M), balls(nominal)))):
            return Judgement(Verdict.CERTIFIED, 1 - norm)
        if decide(lambda: is_negative_at(lemma1_form(balls(M), balls(nominal)), vector)):
            return Judgement(Verdict.REFUTED, 1 - norm, Lemma1Witness(posture=self.posture, norm=norm))
        return Judgement(Verdict.INCONCLUSIVE, 1 - norm)

    def forms(self) -> dict[str, Array]:
        """Return M M̂ + M̂ M − M̂²."""
        return {"M M̂ + M̂ M − M̂²": lemma1_form(self.inertia, self.nominal_inertia)}


def check_lemma1(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    samples: int = 2000,
    seed: int = 0,
    spread: InertiaSpread | None = None,
) -> Certificate[Lemma1Evidence]:
    """Test ‖M(q)⁻¹M̂ − I‖ < 1 over a workspace, for a constant M̂ or an M̂(q) that follows the posture.

    For symmetric matrices this is M M̂ + M̂ M − M̂² > 0, which is affine in M. So if it holds for a robot without and
    with its payload, it holds for every payload between. It is decided at the posture with the largest norm.

    For M̂(q) the memory is in accelerations, and the TDE error obeys ε = (I − M⁻¹M̂) ε_h + … as for a constant M̂. So the
    condition is that of the lemma in each posture. What M̂ changes within the delay only adds to the error, see
    `bound_tde_error`.

    Parameters
    ----------
    law
        A law on time-delay estimation, whose M̂ is tested.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures.
    samples, seed
        Number of sampled postures before the local search, and the seed.
    spread
        Result of `tarc.analysis.inertia_spread` for the same robot, M̂, workspace, samples and seed, where it exists
        already.

    Returns
    -------
    Certificate
        The margin is 1 − ‖M(q)⁻¹M̂ − I‖ at the worst posture. The witness of a refutation is a `Lemma1Witness`.

    Raises
    ------
    UnsupportedLaw
        For a law without a nominal inertia M̂.
    InvalidParameter
        For numbers of joints that differ, and for an M(q) that is singular at a posture.

    References
    ----------
    Paper, Lemma 1, (mass).
    """
    if not isinstance(law, PolePlacement):
        raise UnsupportedLaw(
            f"law: got {type(law).__name__}; Lemma 1 is about M̂, so give a law on time-delay estimation"
        )
    robots = list(plant) if isinstance(plant, Sequence) else [plant]
    for robot in robots:
        if isinstance(robot, Plant) and robot.n_joints != law.n_joints:
            raise InvalidParameter(
                f"law: it drives {law.n_joints} joints and the robot has {robot.n_joints}; give as many"
            )
    if isinstance(law.inertia, NominalInertia):
        evidence = _worst_of_model(law, law.inertia, as_plants(robots), workspace, samples, seed)
    else:
        law, robots = in_torque_units(law, as_plants(robots))
        if spread is None:
            spread = inertia_spread(robots, law.M, workspace, samples=samples, seed=seed)
        evidence = _worst_posture(law.M, robots, workspace, samples, seed, spread)
    verdict, margin, witness = evidence.judge()
    return Certificate(
        evidence=evidence,
        claim="Lemma 1 of the paper holds: ‖M(q)⁻¹M̂ − I‖ < 1 at every posture of the workspace.",
        problem="M(q) M̂ + M̂ M(q) − M̂² > 0, the same for symmetric matrices",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the largest norm",
        assumptions=(
            *_model_assumptions(law, workspace),
            f"the largest norm is the one found from {samples} postures and a local search; a larger one elsewhere is "
            "not excluded",
            "M(q) is the model's, computed in floating point",
            "the norm is in the joints' own units; where they differ, the scaled norm of the evidence says more",
            "left out: the lemma bounds the estimation error for the true acceleration at t − h. This law estimates "
            "the acceleration over a window, and its loop is stable only for far smaller ratios: see the certificates "
            "of the constant and the varying ratio",
        ),
        witness=witness,
        basis=f"{samples} sampled postures and local search",
        proof_grade=verdict == Verdict.REFUTED,
    )


def lemma1_form(M: Array, nominal: Array) -> Array:
    """Return M M̂ + M̂ M − M̂², which is M (I − BBᵀ) M with B = M⁻¹M̂ − I."""
    return M @ nominal + nominal @ M - nominal @ nominal


def _worst_posture(
    nominal: Array, robots: Sequence[Plant], workspace: Workspace, samples: int, seed: int, spread: InertiaSpread
) -> Lemma1Evidence:
    """Return the posture with the largest norm, and the extreme inertia ratios."""
    identity = np.eye(len(nominal))

    def norms(M: Array) -> Array:
        return np.linalg.norm(np.linalg.solve(M, nominal) - identity, 2, axis=(1, 2))

    def norm_gradient(M: Array) -> Array:
        product = np.linalg.solve(M, nominal)
        left, _, right = np.linalg.svd(product - identity)
        return -np.outer(np.linalg.solve(M.T, left[:, 0]), product @ right[0])

    (worst,) = maximise_over_workspace(
        [InertiaFunction(norms, norm_gradient)], robots, workspace, samples=samples, seed=seed
    )
    return Lemma1Evidence(
        inertia=robots[worst.plant].inertia(worst.posture),
        nominal_inertia=nominal,
        posture=worst.posture,
        norm=worst.value,
        scaled_norm=max(abs(1 - spread.min_ratio), abs(1 - spread.max_ratio)),
        min_ratio=spread.min_ratio,
        max_ratio=spread.max_ratio,
        samples=samples,
        plant_index=worst.plant,
    )


def _worst_of_model(
    law: PolePlacement, inertia: NominalInertia, robots: Sequence[Plant], workspace: Workspace, samples: int, seed: int
) -> Lemma1Evidence:
    """Return the posture with the largest norm for an M̂(q), and the extreme inertia ratios."""
    known, units = KnownInertia(inertia), workspace.unit_samples(samples, seed)
    postures = workspace.sample(samples, seed)
    points = [OperatingPoint.at_rest(robot, posture) for robot in robots for posture in postures]

    def ratios(some: Sequence[OperatingPoint]) -> Array:
        return np.linalg.eigvalsh(known.uncertainty(some).inertia)

    def norms(some: Sequence[OperatingPoint]) -> Array:
        return contraction_norms(law, some)

    worst = largest_point(worst_points(points, norms, workspace, units), norms)
    lowest = worst_points(points, lambda some: -ratios(some)[:, 0], workspace, units)
    highest = worst_points(points, lambda some: ratios(some)[:, -1], workspace, units)
    values = ratios([*lowest, *highest])
    growth = np.exp(_model_rate(known, workspace, postures) * law.period * delay_periods(law) / 2)
    return Lemma1Evidence(
        inertia=worst.plant.inertia(worst.position),
        nominal_inertia=known.inertias([worst])[0],
        posture=worst.position,
        norm=float(norms([worst])[0]),
        scaled_norm=float(growth * np.abs(1 - values).max()),
        min_ratio=float(values.min()),
        max_ratio=float(values.max()),
        samples=samples,
        plant_index=next(i for i, robot in enumerate(robots) if robot is worst.plant),
    )


def _model_rate(known: KnownInertia, workspace: Workspace, postures: Array) -> float:
    """Return the largest rate of M̂(q) [1/s] at some postures; zero for a workspace without speeds."""
    if workspace.speed is None:
        return 0.0
    robot = known.inertia.robot
    return float(known.rates([OperatingPoint.at_rest(robot, q) for q in postures], workspace.speed).max())


def _model_assumptions(law: PolePlacement, workspace: Workspace) -> tuple[str, ...]:
    """Return what the lemma takes for granted where M̂ follows the posture."""
    if not isinstance(law.inertia, NominalInertia):
        return ()
    notes = ["M̂(q) is that of the posture, and the law's memory is in accelerations"]
    if workspace.speed is None:
        notes.append("the workspace has no speeds, so that the scaled norm leaves out what M̂ changes within the delay")
    return tuple(notes)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConditionC2Witness:
    """A unit vector at which the form of P3 P2ᵀ is not positive, shape (n,)."""

    vector: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Counterexample:
    """An error and its rate at which Δsᵀs = ė1ᵀ P3 P2 e1 is negative, although (c2) holds.

    Attributes
    ----------
    error, error_rate
        e1 and ė1, unit vectors, each (n,).
    value
        Δsᵀs there.
    """

    error: Array
    error_rate: Array
    value: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ConditionC2Evidence(Evidence):
    """The Lyapunov equation of a law, and where (c2) does not imply Δsᵀs > 0.

    Attributes
    ----------
    A, P, Q
        Matrices of AᵀP + PA = −Q, each (2n, 2n).
    residual
        ‖AᵀP + PA + Q‖ / ‖Q‖.
    shrinking
        Counterexample with ė1 = −e1, an error that shrinks.
    growing
        Counterexample where ‖s‖ grows; None where P3 P2 and P2ᵀP2 are parallel.
    """

    kind: ClassVar[str] = "c2"
    witness_type: ClassVar[type[ConditionC2Witness]] = ConditionC2Witness

    A: Array
    P: Array
    Q: Array
    residual: float
    shrinking: Counterexample
    growing: Counterexample | None

    def judge(self) -> Judgement:
        """Return the verdict from A and P, in ball arithmetic."""
        values, vectors = np.linalg.eigh(condition_c2_form(self.P))
        margin = float(values[0] / max(np.max(np.abs(values)), 1e-300))

        def holds() -> bool:
            A, P = balls(self.A), balls(self.P)
            return (
                is_positive_definite(P)
                and is_positive_definite(-(A.T @ P + P @ A))
                and is_positive_definite(condition_c2_form(P))
            )

        if decide(holds):
            return Judgement(Verdict.CERTIFIED, margin)
        if decide(lambda: is_negative_at(condition_c2_form(balls(self.P)), vectors[:, 0])):
            return Judgement(Verdict.REFUTED, margin, ConditionC2Witness(vector=vectors[:, 0]))
        return Judgement(Verdict.INCONCLUSIVE, margin)

    def forms(self) -> dict[str, Array]:
        """Return P, −(AᵀP + PA) and the symmetric part of P3 P2ᵀ."""
        A, P = self.A, self.P
        return {"P": P, "−(AᵀP + PA)": -(A.T @ P + P @ A), "P3 P2ᵀ": condition_c2_form(P)}


def check_condition_c2(law: Law) -> Certificate[ConditionC2Evidence]:
    """Test condition (c2), P3 P2ᵀ > 0 (its symmetric part), for the P of a law.

    P is a floating-point matrix, and solves its Lyapunov equation for a slightly different Q. The paper needs some
    Q > 0. Ball arithmetic decides P > 0, AᵀP + PA < 0 and (c2) for exactly the stored P.

    Returns
    -------
    Certificate
        The margin is the least eigenvalue of (P3 P2ᵀ + P2 P3)/2 over the largest. The evidence contains states at
        which Δsᵀs is negative: (c2) does not imply Δsᵀs > 0.

    Raises
    ------
    UnsupportedLaw
        For a law without a P.

    References
    ----------
    Paper, (c2), and (new 1) in the proof of Theorem 2, which does not follow from it.
    """
    if not isinstance(law, TARC):
        raise UnsupportedLaw(f"law: got {type(law).__name__}; condition (c2) is about the P of tarc.laws.TARC")
    residual = np.linalg.norm(law.A.T @ law.P + law.P @ law.A + law.Q, 2) / np.linalg.norm(law.Q, 2)
    evidence = ConditionC2Evidence(
        A=law.A,
        P=law.P,
        Q=law.Q,
        residual=float(residual),
        shrinking=_shrinking_counterexample(law),
        growing=_growing_counterexample(law),
    )
    verdict, margin, witness = evidence.judge()
    return Certificate(
        evidence=evidence,
        claim="Condition (c2) of the paper holds: P3 P2ᵀ is positive definite.",
        problem="P > 0, AᵀP + PA < 0, P3 P2ᵀ + P2 P3 > 0",
        verdict=verdict,
        margin=margin,
        margin_meaning="least over greatest eigenvalue of the symmetric part of P3 P2ᵀ",
        assumptions=(
            "gains and P are the floating-point numbers that the law runs with",
            "left out: the paper concludes Δsᵀs > 0 from it, but Δsᵀs = ė1ᵀ P3 P2 e1 is negative where the error "
            "shrinks, as from the stored e1 at ė1 = −e1",
        ),
        witness=witness,
        proof_grade=verdict != Verdict.INCONCLUSIVE,
    )


def condition_c2_form(P: Array) -> Array:
    """Return the symmetric part of P3 P2ᵀ."""
    n = len(P) // 2
    product = P[n:, n:] @ P[n:, :n].T
    return (product + product.T) / 2


def _shrinking_counterexample(law: TARC) -> Counterexample:
    """Return a state with ė1 = −e1 and Δsᵀs < 0.

    The trace of P3 P2 is that of P3 P2ᵀ, positive under (c2), so the top eigenvalue is positive as well.
    """
    product = law.P3 @ law.P2
    e1 = np.linalg.eigh((product + product.T) / 2)[1][:, -1]
    return Counterexample(error=e1, error_rate=-e1, value=float(-e1 @ product @ e1))


def _growing_counterexample(law: TARC) -> Counterexample | None:
    """Return a state where ‖s‖ grows and Δsᵀs < 0; None where P3 P2 and P2ᵀP2 are parallel."""
    product, growth = law.P3 @ law.P2, law.P2.T @ law.P2
    for e1 in np.eye(law.n_joints):
        ahead = growth @ e1 / np.linalg.norm(growth @ e1)
        behind = product @ e1 / np.linalg.norm(product @ e1)
        if np.linalg.norm(ahead - behind) > 1e-6:
            rate = (ahead - behind) / np.linalg.norm(ahead - behind)
            return Counterexample(error=e1, error_rate=rate, value=float(rate @ product @ e1))
    return None
