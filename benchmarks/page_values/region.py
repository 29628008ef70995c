"""Values of the region of attraction: certified errors, and runs of the nonlinear robot from the boundary."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.page_values.registry import Value, long_source, table
from tarc import Feedforward, NominalInertia, simulate
from tarc.analysis import Workspace, best_inertia_shape
from tarc.certificates import certify_region
from tarc.core.types import Array
from tarc.estimators import Algebraic
from tarc.laws import TARC, TDC
from tarc.plants import Plant, TwoLinkArm, load_robot
from tarc.signals import Encoder, Quintic
from tarc.signals.disturbances import Disturbance

BITS, SAMPLES = 17, 200
HEADS = [
    "robot, R [mrad]",
    "start R₀ [mrad]",
    "end R∞ [mrad]",
    "decay rate [1/s]",
    "runs, of which left the tube",
    "largest error in them, of R",
    "error in the end, of R∞",
]
FREQUENCIES = 3.0, 10.0, 20.0, 40.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Triangle(Disturbance):
    """A torque [N m] that changes at a steady rate, up and down in turn."""

    frequency: float

    def profile(self, times: np.ndarray, n_joints: int, rng: np.random.Generator) -> np.ndarray:
        """Return a triangular wave between −1 and 1."""
        return 2 / np.pi * np.arcsin(np.sin(self.frequency * times))


def row(
    label: str,
    plants: Sequence[Plant],
    law: TDC | TARC,
    reference: Quintic,
    rate: Array,
    *,
    size: float,
    runs: int,
    friction: float = 0.0,
) -> tuple[str, ...]:
    """Return what is certified for the largest error R, and what runs from the boundary reach."""
    duration = float(reference.times[-1])
    found = certify_region(
        law,
        plants,
        reference,
        duration,
        max_error=size,
        measurement_error=np.pi / 2**BITS,
        torque_rate=rate,
        max_torque=rate * np.pi / 2 / min(FREQUENCIES),
        friction=friction,
        samples=SAMPLES,
    )
    evidence, rng = found.evidence, np.random.default_rng(0)
    if evidence.proof is None:
        return (f"{label}, {1e3 * size:g}", *(["–"] * (len(HEADS) - 1)))
    values, vectors = np.linalg.eigh(evidence.nominal_inertia)
    inverse_root = vectors * values**-0.5 @ vectors.T
    largest = final = 0.0
    left = 0
    for i in range(runs):
        direction = rng.normal(size=law.n_joints)
        offset = 0.9999 * evidence.start_error * inverse_root @ direction / np.linalg.norm(direction)
        signs, frequency = rng.choice([-1.0, 1.0], law.n_joints), FREQUENCIES[i % len(FREQUENCIES)]
        run = simulate(
            plants[i % len(plants)],
            law,
            reference,
            duration,
            sensor=Encoder(bits=BITS),
            initial_position=reference.sample([0.0])[0][:, 0] + offset,
            initial_torque="rest",
            disturbance=Triangle(amplitude=signs * rate * np.pi / 2 / frequency, frequency=frequency),
            progress=False,
        )
        error = np.abs((run.data["position"] - run.data["reference"]).values)
        largest = max(largest, float((error / evidence.tube_errors).max()))
        left += bool(np.any(error > evidence.tube_errors))
        final = max(final, float((error[-500:] / evidence.final_errors).max()))
    starts, ends = (
        ", ".join(f"{1e3 * value:.2g}" for value in part) for part in (evidence.start_errors, evidence.final_errors)
    )
    decay = f"{evidence.proof.decay_rate:.2g}"
    return f"{label}, {1e3 * size:g}", starts, ends, decay, f"{runs}, {left}", f"{largest:.2f}", f"{final:.2f}"


def arm_rows(first: int = 0) -> list[tuple[str, ...]]:
    """Return the rows of the two-link arm, under TDC and TARC, from one on."""
    arm = TwoLinkArm(viscous=0.2)
    swing = Quintic(points=[[0.2, 0.8], [0.8, 1.4], [0.2, 0.8]], times=[0.0, 2.0, 4.0])
    common: dict[str, Any] = {
        "inertia": 0.08 * arm.inertia([0.0, 1.1]),
        "natural_frequency": 20.0,
        "period": 1e-3,
        "estimator": Algebraic(window=0.006),
    }
    weight = np.array([800.0, 800.0, 1.0, 1.0])
    adaptive = TARC(
        **common, rise_rate=4000.0, fall_rate=2000.0, max_gain=5.0, boundary_layer=0.02, lyapunov_weight=weight
    )
    rate = np.array([5.0, 5.0])
    known = TDC(**{**common, "inertia": NominalInertia(arm, 0.08, gravity=True)})
    loaded = [arm, arm.with_parameters({"payload": 0.3})]
    cases = [
        ("TDC", TDC(**common), [arm], 0.1),
        ("TDC", TDC(**common), [arm], 0.3),
        ("TARC", adaptive, [arm], 0.1),
        ("TDC with M̂(q)", known, [arm], 0.1),
        ("TDC with M̂(q), 0 to 0.3 kg that the model lacks", known, loaded, 0.2),
    ][first:]
    return [
        row(f"two-link arm, {name}", arms, law, swing, rate, size=size, runs=100) for name, law, arms, size in cases
    ]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A UR5e under TDC: the loads [kg] and dry friction [N m] of the robot, M̂ over its best shape, natural frequency
    [rad/s], R [rad], the load of a model that is fed forward, None for no feed-forward, whether M̂(q) follows a model
    without load, and the number of runs.
    """

    label: str
    loads: tuple[float, ...] = (0.0,)
    friction: float = 0.0
    fraction: float = 0.05
    frequency: float = 20.0
    synchronised: bool = False
    size: float = 0.05
    model_load: float | None = None
    known: bool = False
    runs: int = 40


CASES = (
    Case(label="UR5e"),
    Case(label="UR5e, 2 N m of dry friction", friction=2.0, frequency=40.0, size=0.1),
    Case(label="UR5e, 0 to 5 kg, synchronised", loads=(0.0, 5.0), fraction=0.1, synchronised=True),
    Case(label="UR5e with 1 kg that its feed-forward lacks", loads=(1.0,), model_load=0.0),
    Case(
        label="UR5e, 0 to 5 kg, synchronised, feed-forward with 2.5 kg",
        loads=(0.0, 5.0),
        fraction=0.1,
        synchronised=True,
        model_load=2.5,
    ),
    Case(label="UR5e, 0 to 5 kg that M̂(q) lacks", loads=(0.0, 5.0), fraction=0.08, known=True, runs=8),
    Case(
        label="UR5e, 0 to 5 kg that M̂(q) lacks, synchronised",
        loads=(0.0, 5.0),
        fraction=0.6,
        synchronised=True,
        known=True,
        runs=8,
    ),
)


def ur5e_row(case: Case) -> tuple[str, ...]:
    """Return the row of a UR5e."""
    home, change = np.array([0.0, -1.2, 1.5, -1.8, -1.57, 0.3]), np.array([0.4, 0.3, -0.4, 0.3, 0.3, 0.5])
    motion = Quintic(points=np.array([home, home + change, home]), times=[0.0, 3.0, 6.0])

    def robot(load: float, friction: float) -> Any:
        return load_robot("ur5e", armature=0.1, viscous=1.0, coulomb=friction, payload=load)

    robots = [robot(load, case.friction) for load in case.loads]
    if case.known:
        inertia: Any = NominalInertia(load_robot("ur5e", armature=0.1), case.fraction, gravity=True)
    else:
        inertia = case.fraction * best_inertia_shape(robots, Workspace.from_reference(motion, 6.0, tube=case.size))[0]
    law = TDC(
        inertia=inertia,
        natural_frequency=case.frequency,
        period=1e-3,
        estimator=Algebraic(window=0.006),
        synchronised=case.synchronised,
        feedforward=None if case.model_load is None else Feedforward(robot(case.model_load, 0.0)),
    )
    rate = np.array([5.0, 5.0, 5.0, 1.0, 1.0, 1.0])
    return row(case.label, robots, law, motion, rate, size=case.size, runs=case.runs, friction=case.friction)


@long_source
def region() -> dict[str, Value]:
    """Errors from which a law recovers, certified and attacked."""
    return {"attacked": table(HEADS, [*arm_rows(), *map(ur5e_row, CASES)])}
