"""What a design must meet, with all defaults.

The command line makes its options from this class. So the module imports numerical libraries where it uses them.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tarc.core.errors import InvalidParameter

if TYPE_CHECKING:
    from tarc.analysis.workspace import Workspace
    from tarc.core.validation import Numbers
    from tarc.signals.sensors import Encoder

LAWS = ("TARC", "TDC")
"""Laws that can be designed."""
MODELS = ("none", "inertia", "known")
"""What a law may know of the robot."""
DEFAULT_ENCODER_BITS = 17
"""Bits per turn of the default encoder."""
DEFAULT_NOISE_BUDGET = 0.01
"""Torque change by noise over the torque limit, where neither a budget nor a natural frequency is given."""
SLOPE_RATIO = {"TARC": 1.0, "TDC": 0.0}
"""Largest slope of the robust term over the position gain K1. It costs up to a quarter of the tolerated spread."""


def default_encoder() -> "Encoder":
    """Return the encoder of a design that is given none."""
    from tarc.signals.sensors import Encoder

    return Encoder(bits=DEFAULT_ENCODER_BITS)


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignRequirements:
    """Requirements on a controller. All defaults of a design are here.

    Parameters
    ----------
    period
        Control period [s].
    sensor
        The encoder of every joint. Default: 17 bits per turn.
    payload
        Smallest and largest payload at the tool [kg].
    workspace
        Postures and speeds to certify. Default: see ``joint_range`` and ``speed``.
    joint_range
        Certify only postures within this distance of the home posture, for every joint [rad or m]. Default: all that
        the joints reach.
    speed
        Largest joint speed [rad/s or m/s], one number or one per joint; ``inf`` for any. A lower speed admits better
        gains. Default: the velocity limits in the robot's file; a given workspace keeps its own.
    acceleration
        Largest joint acceleration [rad/s² or m/s²], one number or one per joint. Default: reaches the largest
        speed in 0.25 s; a given workspace keeps its own.
    natural_frequency
        ωn of the error [rad/s]. Default: chosen, as high as the noise budget allows.
    damping_ratio
        ζ of the error.
    noise_budget
        Largest RMS change of each joint's torque from one period to the next by the encoders' noise, over its torque
        limit, such as 0.02 for 2 %. The torque variation by noise is √(2/π)/T of it. Default: 0.01, exceeded where no
        certified loop meets it, or where the error falls faster than the square of the noise. With a given natural
        frequency there is no default.
    torque_limits
        Torque limits [N m or N], one number or one per joint. Default: those in the robot's file.
    torque_rate
        Largest rate of the torque that the robot's interface accepts [N m/s or N/s], one number or one per joint. A
        trial run must keep to it. Default: any.
    model
        Model of the robot in the law. ``none``: M̂ is constant. ``inertia``: M̂(q) = ρ M(q) of the file. ``known``:
        gravity, Coriolis torque and friction of the file as well. The last two need a speed.
    armature_error
        For a model: share by which the true rotor inertia may differ from the file's, such as 0.2 for 20 %.
    mass_error
        For a model: share by which the true mass and inertia of each link may differ from the file's.
    length_error
        For a model: share by which the true length of each link may differ. Its centre of mass and the joint after it
        move with it; mass and inertia about the centre of mass stay.
    friction_error
        For a known model: share by which the true friction may be larger than that of the law.
    friction_width
        For a known model with dry friction: speed w [rad/s or m/s] of its smooth sign tanh(q̇ᵈ/w), one number or one per
        joint.
    law
        ``TARC``, with the adaptive switching gain, or ``TDC``, without. Or ``my_file.py:MyLaw``: a law of your own that
        extends `tarc.laws.TDE`, at the defaults of its own parameters.
    diagonal
        Restrict M̂ to diagonal matrices.
    computation_delay
        Number of periods between a measurement and its torque.
    samples
        Number of sampled postures, before the local search for worse ones.
    seed
        Seed of the sampled postures.

    Raises
    ------
    InvalidParameter
        For a number out of its range.
    """

    period: float = 1e-3
    sensor: "Encoder" = field(default_factory=default_encoder)
    payload: tuple[float, float] = (0.0, 0.0)
    workspace: "Workspace | None" = None
    joint_range: float | None = None
    speed: "Numbers | None" = None
    acceleration: "Numbers | None" = None
    natural_frequency: float | None = None
    damping_ratio: float = 1.0
    noise_budget: float | None = None
    torque_limits: "Numbers | None" = None
    torque_rate: "Numbers | None" = None
    model: str = "none"
    armature_error: float = 0.0
    mass_error: float = 0.0
    length_error: float = 0.0
    friction_error: float = 0.3
    friction_width: "Numbers | None" = None
    law: str = "TARC"
    diagonal: bool = False
    computation_delay: int = 0
    samples: int = 500
    seed: int = 0

    def __post_init__(self) -> None:
        from tarc.core import validation as check

        if not self.has_own_law:
            check.one_of("law", self.law, LAWS)
        check.number("period", self.period, 0, strict=True)
        low, high = (check.number("payload", mass, 0) for mass in self.payload)
        if high < low:
            raise InvalidParameter(f"payload: got {low:g} to {high:g} kg; needs the smallest first")
        object.__setattr__(self, "payload", (low, high))
        check.one_of("model", self.model, MODELS)
        for name in ("armature_error", "mass_error", "length_error", "friction_error"):
            share = check.number(name, getattr(self, name), 0)
            if not share < 1:
                raise InvalidParameter(
                    f"{name}: got {share:g}; needs a share below 1, such as 0.2 for 20 %, beyond which M̂(q)⁻¹M "
                    "need not be definite"
                )
        check.number("damping_ratio", self.damping_ratio, 0, strict=True)
        for name in ("natural_frequency", "joint_range"):
            if getattr(self, name) is not None:
                check.number(name, getattr(self, name), 0, strict=True)
        if self.noise_budget is not None and not 0 < self.noise_budget <= 1:
            raise InvalidParameter(
                f"noise_budget: got {self.noise_budget:g}; needs a share of the torque limit, such as 0.02 for 2 %"
            )
        check.integer("computation_delay", self.computation_delay)
        check.integer("samples", self.samples, 1)
        check.integer("seed", self.seed)
        if self.workspace is not None and self.joint_range is not None:
            raise InvalidParameter("workspace, joint_range: both are given; give one of them")

    @property
    def has_own_law(self) -> bool:
        """Whether the law is from a user's own file."""
        return "." in self.law

    @property
    def slope_ratio(self) -> float:
        """Largest slope of the robust term over K1, for which loops are chosen."""
        return SLOPE_RATIO.get(self.law, max(SLOPE_RATIO.values()))

    @property
    def has_budget(self) -> bool:
        """Whether torque noise is compared with a budget."""
        return self.natural_frequency is None or self.noise_budget is not None

    @property
    def noise_target(self) -> float:
        """The noise budget, or its default."""
        return DEFAULT_NOISE_BUDGET if self.noise_budget is None else self.noise_budget
