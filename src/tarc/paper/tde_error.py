"""The paper's bound on the error of time-delay estimation, for a constant M̂ and for one that follows the posture."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.known_inertia import KnownInertia, PointValues, worst_points
from tarc.analysis.linearise import require_inertia
from tarc.analysis.operating_points import OperatingPoint
from tarc.analysis.workspace import Workspace
from tarc.analysis.worst_points import sample_points
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tde import TDE
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant


@dataclass(frozen=True, kw_only=True, eq=False)
class TDEErrorBound:
    """Bound on the TDE error ε = q̈ − u where the law knows the acceleration of an instant h ago.

    Attributes
    ----------
    contraction
        b, largest ‖I − M(q)⁻¹M̂(q)‖; the lemma needs b < 1.
    forcing
        d, what the motion within the delay h adds at most [rad/s² or m/s²].
    bound
        (d + b ‖u − u_h‖)/(1 − b) for the given change of u [rad/s² or m/s²]; infinite for b ≥ 1.
    contraction_posture
        q of the largest norm, shape (n,) [rad or m].
    forcing_point
        q, q̇ and q̈ of the largest forcing, shape (3, n).
    delay
        h [s].
    """

    contraction: float
    forcing: float
    bound: float
    contraction_posture: Array
    forcing_point: Array
    delay: float

    @property
    def amplification(self) -> float:
        """1/(1 − b), by which what is added in each delay accumulates; infinite for b ≥ 1."""
        return 1 / (1 - self.contraction) if self.contraction < 1 else np.inf


def bound_tde_error(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    command_change: float = 0.0,
    samples: int = 1000,
    seed: int = 0,
) -> TDEErrorBound:
    """Return the bound of Lemma 1 on the TDE error, over all motions within a workspace.

    With B = M⁻¹M̂ and the memory in accelerations, the law and the robot give

        ε = (I − B) ε_h + (B − I)(u − u_h) + B (β_h − β),     β = M̂(q)⁻¹ (M(q) q̈_h + N(q, q̇) − ĥ(q, q̇))

    where only q and q̇ differ between β_h and β. For a constant M̂ and ĥ = 0 this is the equation of the lemma. With
    M̂(q) = ρ M(q) the part M̂⁻¹M of β is constant, and M̂ changes the memory of N − ĥ instead. To first order in h

        ‖B (β_h − β)‖ ≤ d = h sup ‖B (∂β/∂q q̇ + ∂β/∂q̇ q̈)‖,     ‖ε‖ ≤ (d + b ‖u − u_h‖)/(1 − b) after transients.

    Parameters
    ----------
    law
        A law on time-delay estimation. Its estimator does not count: the lemma takes q̈_h as known.
    plant
        The robot in symbols, or several.
    workspace
        The postures, with speeds and accelerations.
    command_change
        Largest ‖u − u_h‖ [rad/s² or m/s²].
    samples, seed
        Number of sampled postures, and the seed. Local searches start from the worst samples.

    Returns
    -------
    TDEErrorBound
        Its suprema are the largest values found.

    Raises
    ------
    UnsupportedLaw
        For a law without time-delay estimation, and a workspace without speeds.
    InvalidParameter
        For numbers of joints that differ, and a robot that is not in symbols.

    References
    ----------
    Paper, Lemma 1.
    """
    law = require_inertia(law, "bound_tde_error")
    if not isinstance(law, TDE) or workspace.speed is None or workspace.acceleration is None:
        raise UnsupportedLaw(
            f"law: got {type(law).__name__}; bound_tde_error needs a law on time-delay estimation and a workspace with "
            "speeds, such as Workspace.box(low, high, speed=1.0)"
        )
    change = check.number("command_change", command_change, 0)
    plants = as_plants(plant)
    if not isinstance(law.inertia, NominalInertia):
        law, plants = in_torque_units(law, plants)
    motion = _MotionInDelay(law, plants)
    workspace = workspace.for_joints(plants[0].joint_names)
    points = sample_points(plants, workspace, samples, seed)
    units = workspace.unit_samples(samples, seed)
    resting = [point for point in points if not point.is_moving]
    norms = motion.contractions
    widest = largest_point(worst_points(resting, norms, workspace, units), norms)
    fastest = largest_point(worst_points(points, motion.rates, workspace, units), motion.rates)
    contraction = float(norms([widest])[0])
    forcing = law.delay_periods * law.period * float(motion.rates([fastest])[0])
    bound = (forcing + contraction * change) / (1 - contraction) if contraction < 1 else np.inf
    return TDEErrorBound(
        contraction=contraction,
        forcing=forcing,
        bound=bound,
        contraction_posture=widest.position,
        forcing_point=np.array([fastest.position, fastest.velocity, fastest.acceleration]),
        delay=law.delay_periods * law.period,
    )


def inertias_at(law: PolePlacement, points: Sequence[OperatingPoint]) -> Array:
    """Return M̂ of a law at k points, shape (k, n, n)."""
    if isinstance(law.inertia, NominalInertia):
        return KnownInertia(law.inertia).inertias(points)
    return np.broadcast_to(law.M, (len(points), *law.M.shape))


def contraction_norms(law: PolePlacement, points: Sequence[OperatingPoint]) -> Array:
    """Return ‖M(q)⁻¹M̂(q) − I‖ at k points, shape (k,)."""
    M = np.array([point.plant.inertia(point.position) for point in points])
    return np.linalg.norm(np.linalg.solve(M, inertias_at(law, points)) - np.eye(law.n_joints), 2, axis=(1, 2))


def delay_periods(law: PolePlacement) -> int:
    """Return the delay h of time-delay estimation in periods; one for a law without it."""
    return law.delay_periods if isinstance(law, TDE) else 1


class _MotionInDelay:
    """Contraction and rate of β of a law on some robots."""

    def __init__(self, law: PolePlacement, plants: Sequence[Plant]):
        self.law = law
        self.functions = {id(plant): self._rate_function(plant) for plant in plants}

    def contractions(self, points: Sequence[OperatingPoint]) -> Array:
        return contraction_norms(self.law, points)

    def rates(self, points: Sequence[OperatingPoint]) -> Array:
        """Return ‖M⁻¹M̂ (∂β/∂q q̇ + ∂β/∂q̇ q̈)‖ [rad/s³ or m/s³] at k points, shape (k,)."""
        found = np.empty(len(points))
        groups: dict[int, list[int]] = {}
        for i, point in enumerate(points):
            groups.setdefault(id(point.plant), []).append(i)
        for plant, places in groups.items():
            q, v, a = np.array([points[i][1:] for i in places]).transpose(1, 2, 0)
            found[places] = np.linalg.norm(np.array(self.functions[plant](q, v, a)), axis=0)
        return found

    def _rate_function(self, plant: Plant) -> ca.Function:
        n, law = self.law.n_joints, self.law
        if not isinstance(plant, SymbolicPlant) or plant.n_joints != n:
            raise InvalidParameter(
                f"plant: got {type(plant).__name__} with {plant.n_joints} joints; needs a robot in symbols with the "
                f"{n} joints of the law"
            )
        q, v, a, held = (ca.SX.sym(name, n) for name in ("q", "v", "a", "held"))
        M = plant.evaluate("inertia", q)
        torque = M @ held + plant.evaluate("bias", q, v)
        if isinstance(law.inertia, NominalInertia):
            torque = torque - law.inertia.forces(q, v)
        nominal = law.inertia_at(q)
        beta = ca.solve(ca.SX(nominal), torque)
        change = ca.jtimes(beta, q, v) + ca.jtimes(beta, v, a)
        rate = ca.solve(M, ca.SX(nominal) @ change)
        return ca.Function("rate", [q, v, a], [ca.substitute(rate, held, a)], {"cse": True})


def largest_point(points: Sequence[OperatingPoint], values: PointValues) -> OperatingPoint:
    """Return the point of the largest value."""
    return points[int(np.argmax(values(points)))]
