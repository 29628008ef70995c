"""Values of the paper's Lemma 1 for its constant M̂ and for an M̂(q) of a model."""

from collections.abc import Sequence
from typing import Any

from benchmarks.page_values.registry import Value, source, table
from tarc import NominalInertia
from tarc.analysis import Workspace, best_inertia_shape
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.paper import bound_tde_error, check_lemma1
from tarc.plants import Plant, TwoLinkArm, load_robot

SAMPLES = 1000
SPEED = 1.0
HEADS = ["robot", "M̂", "b, scaled", "1/(1 − b)", "b in joint units", "d [mrad/s²]"]


def law(inertia: Any) -> TDC:
    """Return TDC with the delay of one millisecond."""
    return TDC(inertia=inertia, natural_frequency=10.0, period=1e-3, estimator=Algebraic(window=0.006))


def robots(name: str, load: float) -> tuple[Plant, list[Plant]]:
    """Return the model of a robot, and the robots with rotors 20 % off, without and with its load."""
    model = load_robot(name, armature=0.1)
    return model, [load_robot(name, armature=rotor, payload=mass) for rotor in (0.08, 0.12) for mass in (0.0, load)]


def rows(label: str, model: Plant, plants: Sequence[Plant]) -> list[tuple[str, ...]]:
    """Return what the lemma says of the best constant M̂ and of M̂(q), each with its ratios centred at one."""
    workspace = Workspace.from_joint_limits(model).with_speed_limits(SPEED)
    shape, spread = best_inertia_shape(plants, workspace, samples=SAMPLES)
    frozen = check_lemma1(law(NominalInertia(model, 1.0)), plants, workspace, samples=SAMPLES).evidence
    fraction = 2 / (frozen.min_ratio + frozen.max_ratio)
    inertias = {
        "constant": 2 / (1 + spread) * shape,
        "M̂(q)": NominalInertia(model, fraction),
        "M̂(q), ĥ with gravity and Coriolis torque": NominalInertia(model, fraction, gravity=True, coriolis=True),
    }
    found = []
    for name, inertia in inertias.items():
        evidence = check_lemma1(law(inertia), plants, workspace, samples=SAMPLES).evidence
        bound = bound_tde_error(law(inertia), plants, workspace, samples=SAMPLES)
        scaled = evidence.scaled_norm
        amplification = f"{1 / (1 - scaled):.3g}" if scaled < 1 else "none"
        found.append(
            (label, name, f"{scaled:.3f}", amplification, f"{evidence.norm:.3g}", f"{1e3 * bound.forcing:.3g}")
        )
    return found


@source
def lemma1() -> dict[str, Value]:
    """Contraction and forcing of the TDE error by the lemma, for a constant M̂ and for M̂(q)."""
    arm = TwoLinkArm()
    found = rows("two-link arm, 0 to 0.5 kg", arm, [arm, TwoLinkArm(payload=0.5)])
    found += rows("UR5e, 0 to 5 kg", *robots("ur5e", 5.0))
    found += rows("Panda, 0 to 3 kg", *robots("panda", 3.0))
    return {"models": table(HEADS, found)}
