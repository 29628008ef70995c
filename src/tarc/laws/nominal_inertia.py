"""Known parts of a robot's dynamics in a law: M̂(q) from a model, and feed-forward along the reference."""

from dataclasses import KW_ONLY, dataclass
from functools import cached_property

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant

MAX_FRACTION = 2.0
"""Largest ρ: beyond it Lemma 1, ‖M⁻¹M̂ − I‖ < 1, fails even for the exact model."""

MIN_EIGENVALUE = 1e-9
"""Smallest eigenvalue of a model's inertia with its diagonal scaled to one, below which it counts as singular."""

N_POSTURES = 20
"""Number of postures at which a model's inertia is checked."""


@dataclass(frozen=True, eq=False)
class ModelTerms:
    """Terms of a model's equations of motion, each switched on by itself.

        h(q, q̇) = [C(q, q̇) q̇] + [g(q)] + [F(q, q̇)]

    Parameters
    ----------
    model
        Robot of `tarc.plants` in symbols. Its parameters may differ from those of the true robot.
    gravity
        Include g(q), with the springs of the joints.
    coriolis
        Include C(q, q̇) q̇.
    friction
        Include the model's friction F at q̇ᵈ.
    friction_width
        Speed w [rad/s or m/s] of the smooth sign tanh(q̇ᵈ/w) of dry friction, one number or one per joint. Needed where
        the model has dry friction.
    """

    model: Plant
    _: KW_ONLY
    gravity: bool = False
    coriolis: bool = False
    friction: bool = False
    friction_width: Numbers | None = None

    def __post_init__(self) -> None:
        kind = type(self).__name__
        if not isinstance(self.model, SymbolicPlant):
            received = type(self.model).__name__ if isinstance(self.model, Plant) else repr(self.model)
            raise InvalidParameter(
                f"model: got {received}; {kind} needs a robot in symbols, whose equations become part of the law, such "
                "as load_robot gives without contacts and with backend='symbolic', or one of tarc.plants",
                "model",
            )
        self.model.require_fully_driven(f"the model of {kind}")
        if self.model.in_torque_units() is not self.model:
            raise InvalidParameter(
                f"model: the joints of {self.model.label} have inner loops; {kind} needs a robot that takes torques, "
                "such as its in_torque_units()",
                "model",
            )
        for name in ("gravity", "coriolis", "friction"):
            if not isinstance(getattr(self, name), bool):
                raise InvalidParameter(f"{name}: got {getattr(self, name)!r}; needs true or false", name)
        self._check_friction(self.model)
        _check_inertia(self.model)

    def _check_friction(self, model: SymbolicPlant) -> None:
        """Refuse dry friction without a width, and a width that has nothing to act on."""
        dry = [name for name in model.dry_friction if np.any(model.parameters.get(name, 0.0))]
        has_width = "coulomb_width" in model.parameters
        if self.friction_width is None:
            if self.friction and dry and has_width:
                raise InvalidParameter(
                    f"friction_width: missing; the model has dry friction ({', '.join(dry)}), whose sign is smoothed "
                    "by tanh(q̇ᵈ/w). Give w [rad/s or m/s], such as 0.05, or friction=False",
                    "friction_width",
                )
            return
        check.vector("friction_width", self.friction_width, model.n_joints, 0, strict=True)
        if not self.friction or not has_width:
            reason = "without friction=True" if has_width else f"for {model.label}, whose friction has no width"
            raise InvalidParameter(
                f"friction_width: got {self.friction_width!r} {reason}; leave it out", "friction_width"
            )

    @property
    def terms(self) -> set[str]:
        """Return the names of the terms that are on."""
        return {name for name in ("gravity", "coriolis", "friction") if getattr(self, name)}

    @property
    def robot(self) -> SymbolicPlant:
        """Return the model."""
        assert isinstance(self.model, SymbolicPlant)
        return self.model

    @cached_property
    def _friction_parameters(self) -> dict[str, Vector]:
        if self.friction_width is None:
            return {}
        own = self.robot.parameters["coulomb_width"]
        return {"coulomb_width": np.broadcast_to(np.asarray(self.friction_width, dtype=float), own.shape)}

    def forces(self, position: Vector, velocity_reference: Vector) -> Vector:
        """Return h(q, q̇ᵈ) [N m or N], shape (n,); accepts CasADi symbols."""
        model, total = self.robot, 0 * velocity_reference
        if self.coriolis:
            total = model.evaluate("bias", position, velocity_reference)
            total = total - model.evaluate("friction", position, velocity_reference)
        if self.coriolis != self.gravity:
            gravity = model.evaluate("gravity", position)
            total = total + gravity if self.gravity else total - gravity
        if self.friction:
            total = total + model.evaluate(
                "friction", position, velocity_reference, parameters=self._friction_parameters
            )
        return total


@dataclass(frozen=True, eq=False)
class NominalInertia(ModelTerms):
    """Nominal inertia that follows the posture, M̂(q) = ρ M_m(q), for a law on time-delay estimation.

        a_k = a_{k−1} + u_k − â_h,     τ_k = M̂(q_k) a_k + ĥ(q_k, q̇ᵈ_k)
        a_{k−1} = M̂(q_{k−1})⁻¹ (τ_{k−1} − ĥ(q_{k−1}, q̇ᵈ_{k−1}))

    τ_{k−1} is the torque that was applied, after all limits. A synchronised law has its average of past a in place of
    a_{k−1}. For M̂ constant and ĥ = 0 these are the equations of `TDE`.

    Parameters
    ----------
    model
        Robot of `tarc.plants` in symbols, with inertia M_m. Its payload, rotor inertia, friction and links may differ
        from the true ones. In a scenario ``true`` is the scenario's robot.
    fraction
        ρ, above 0 and at most 2. With the exact model it is every eigenvalue of M(q)⁻¹M̂(q).
    gravity, coriolis
        Include g(q) and C(q, q̇ᵈ) q̇ᵈ of the model in ĥ.
    friction
        Include the model's friction at q̇ᵈ in ĥ. It is free of noise and right where a joint stands still.
    friction_width
        Speed w [rad/s or m/s] of the smooth sign tanh(q̇ᵈ/w) of dry friction. Needed where the model has dry friction.

    Raises
    ------
    InvalidParameter
        For a model that is not in symbols, has passive joints or inner loops, or a singular inertia. Also for a
        fraction out of range, and dry friction without a width.

    Notes
    -----
    M̂(q) takes most of the spread of M(q)⁻¹M̂ away, and a robot file is enough for it. `ComputedTorque` relies on the
    whole model; here time-delay estimation compensates what the model lacks. The memory is in accelerations, since a
    torque of the period before belongs to another posture.

    Examples
    --------
    >>> import tarc
    >>> arm = tarc.plants.TwoLinkArm()
    >>> law = tarc.laws.TDC(inertia=tarc.NominalInertia(arm, 0.1, gravity=True), natural_frequency=20.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010))
    >>> law.n_joints
    2
    """

    fraction: float

    def __post_init__(self) -> None:
        check.number("fraction", self.fraction, 0, strict=True, high=MAX_FRACTION)
        super().__post_init__()

    def at(self, position: Vector) -> Vector:
        """Return M̂(q) = ρ M_m(q) [kg m² or kg], shape (n, n); accepts CasADi symbols."""
        return self.fraction * self.robot.evaluate("inertia", position)


@dataclass(frozen=True, eq=False)
class Feedforward(ModelTerms):
    """Torque of a model along the reference, for a law on time-delay estimation.

        f_k = (M_m(qᵈ) − M̂) q̈ᵈ + h(qᵈ, q̇ᵈ),     τ_k = M̂ (u_k − â_h) + (τ_h − f_h) + f_k

    It depends on the reference alone, so that the linearised loop and all its certificates stay as they are. With
    M̂(q), f has M̂(qᵈ).

    Parameters
    ----------
    model
        Robot of `tarc.plants` in symbols. In a scenario ``true`` is the scenario's robot.
    inertia
        Include (M_m(qᵈ) − M̂) q̈ᵈ; the law itself gives M̂ q̈ᵈ.
    gravity, coriolis, friction
        Include g(qᵈ), C(qᵈ, q̇ᵈ) q̇ᵈ and the model's friction at q̇ᵈ.
    friction_width
        Speed w [rad/s or m/s] of the smooth sign tanh(q̇ᵈ/w) of dry friction. Needed where the model has dry friction.
    same_window
        Estimate q̇ᵈ and q̈ᵈ of the feedback from samples of qᵈ by the law's own estimator. Then the delay of the window
        is the same on both sides of each error, and f has M_m q̈ᵈ in full. The window starts full of the first qᵈ. The
        terms of the model keep the true q̇ᵈ and q̈ᵈ. Switch it off for references that jump or are noisy. It has no
        effect with `TrueDerivatives`.

    Raises
    ------
    InvalidParameter
        As of `NominalInertia`.
    """

    _: KW_ONLY
    inertia: bool = True
    gravity: bool = True
    coriolis: bool = True
    friction: bool = True
    same_window: bool = True

    def __post_init__(self) -> None:
        for name in ("inertia", "same_window"):
            if not isinstance(getattr(self, name), bool):
                raise InvalidParameter(f"{name}: got {getattr(self, name)!r}; needs true or false", name)
        super().__post_init__()


def _check_inertia(model: SymbolicPlant) -> None:
    """Refuse a model whose inertia is not positive definite at home and at random postures."""
    low, high = np.clip(model.position_limits, -np.pi, np.pi).T
    random = np.random.default_rng(0).uniform(low, high, (N_POSTURES, model.n_joints))
    for position in [model.home, *random]:
        M = model.inertia(position)
        scale = np.sqrt(np.abs(np.diag(M)))
        is_regular = np.all(np.isfinite(M)) and scale.min() > 0
        if not is_regular or np.linalg.eigvalsh(M / np.outer(scale, scale))[0] < MIN_EIGENVALUE:
            raise InvalidParameter(
                f"model: the inertia of {model.label} is singular at q = {position.round(3).tolist()}; give the links "
                "masses, or the joints rotor inertia",
                "model",
            )
