"""How much of what certificates do not cover six designs stand: ``python -m benchmarks.not_covered``.

For each arm of `benchmarks.design`, with the largest payload on the motion of its scenario, one effect at a time is
increased until a run diverges, or its RMS error on the encoders' side is above twice that without the effect. The last
value before is good to a fifth.
"""

import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import tarc
from benchmarks.design import ROBOTS, Robot
from benchmarks.page_values.registry import table
from tarc.design import Design, design_controller
from tarc.design.stress_case import StressCase
from tarc.plants import Gearbox
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals import Drive, Encoder, TorqueLimits

FOLDER = Path(__file__).resolve().parents[1] / "runs" / "not_covered"
DURATION = 3.0
"""Length of a run [s]."""
METRICS_START = 1.0
MAX_ERROR_RATIO = 2.0
BISECTIONS = 2
"""Bisections after the first value that a design does not stand; they leave a fifth between the last two."""
STEPS_PER_OSCILLATION = 20
"""Runge–Kutta steps per oscillation of a gearbox."""
MIN_SUBSTEPS = 4
"""Least Runge–Kutta steps of a gearbox per period."""
CONTACT = 800.0
"""Resonance of the gears with backlash [Hz]."""
DAMPING_RATIO = 0.05
"""Of the resonance of each joint."""


class Effect(NamedTuple):
    """An effect: its name, unit, first and last value tried, and the arguments of `simulate` for a value."""

    name: str
    unit: str
    mild: float
    far: float
    arguments: Callable[["Arm", float], dict[str, Any]]


@dataclass(frozen=True)
class Arm:
    """A design to run: the robot with its largest payload, the torque rate of its own run [N m/s], shape (n,)."""

    name: str
    design: Design
    reference: tarc.signals.Reference
    torque_rate: np.ndarray
    error: float

    @classmethod
    def from_robot(cls, robot: Robot) -> "Arm":
        """Design for an arm and run the design without an effect."""
        made = design_controller(
            robot.plant(), payload=(0.0, robot.payload), speed=robot.speed(), progress=False, samples=500
        )
        blank = cls(robot.name, made, StressCase.from_design(made)._reference(), np.zeros(0), np.nan)
        run = blank.run({})
        torque = run.data["torque"].values
        rate = np.abs(np.diff(torque, axis=0)).max(axis=0) / made.law.period
        return replace(blank, torque_rate=rate, error=_error(run))

    def run(self, arguments: dict[str, Any]) -> tarc.Run:
        """Simulate with arguments that replace those of the design."""
        common = {
            "sensor": self.design.sensor,
            "initial_torque": "rest",
            "computation_delay": self.design.law.actuation_delay,
            "divergence_threshold": 0.5,
            "native": False,
            "progress": False,
        }
        plant = self.design.plants[-1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            given = {**common, **arguments}
            return tarc.simulate(given.pop("plant", plant), self.design.law, self.reference, DURATION, **given)

    def encoder(self, **effect: float) -> dict[str, Any]:
        """Return the design's encoder with an effect, as an argument of `simulate`."""
        return {"sensor": replace(self.design.sensor, **effect)}

    def stands(self, effect: Effect, value: float) -> bool:
        """Return whether a run with an effect completes without twice the error."""
        run = self.run(effect.arguments(self, value))
        return run.status.completed and _error(run) <= MAX_ERROR_RATIO * self.error

    def limit(self, effect: Effect) -> str:
        """Return the last value of an effect up to which the design stands all values tried, as a text.

        The values are doubled or halved from the mild end on, since some effects harm less where they are largest.
        """
        factor = 2.0 if effect.far > effect.mild else 0.5
        value, last = effect.mild, None
        while self.stands(effect, value):
            last = value
            if value == effect.far:
                return f"{'≥' if factor > 1 else '≤'} {_spell(value)}"
            value = min(factor * value, effect.far) if factor > 1 else max(factor * value, effect.far)
        if last is None:
            return f"< {_spell(effect.mild)}" if factor > 1 else "none"
        for _ in range(BISECTIONS):
            middle = float(np.sqrt(last * value))
            if self.stands(effect, middle):
                last = middle
            else:
                value = middle
        return _spell(last)


def _spell(value: float, digits: int = 2) -> str:
    """Return significant digits without an exponent."""
    return f"{float(f'{value:.{digits}g}'):.10g}"


def _error(run: tarc.Run) -> float:
    return run.metrics_or_none(METRICS_START).get("rms_error", np.inf)


def _gearbox(arm: Arm, resonance: float, backlash: float, encoder: str) -> dict[str, Any]:
    """Return gears with a resonance [Hz] of each motor against the links, in the first posture, and with a play [rad].

    K_i = (2πf)² / (1/J_i + (M⁻¹)_ii)
    """
    plant = arm.design.plants[-1]
    if not isinstance(plant, SymbolicPlant):
        raise TypeError(f"{plant.label}: got {type(plant).__name__}; gears need a plant in symbols")
    n = plant.n_joints
    rigid = Gearbox(plant=plant, stiffness=1.0, encoder=encoder)
    posture = arm.reference.sample([0.0])[0][:, 0]
    links = np.linalg.inv(rigid.inertia(np.concatenate([posture, posture]))[:n, :n])
    mobility = 1 / rigid.parameters["gearbox_motor_inertia"] + np.diag(links)
    pulsation = 2 * np.pi * resonance
    values = {
        "gearbox_stiffness": pulsation**2 / mobility,
        "gearbox_twist_damping": 2 * DAMPING_RATIO * pulsation / mobility,
        "gearbox_backlash": np.full(n, backlash),
    }
    substeps = max(int(np.ceil(STEPS_PER_OSCILLATION * resonance * arm.design.law.period)), MIN_SUBSTEPS)
    return {"plant": rigid.with_parameters(values), "substeps": substeps}


EFFECTS = (
    Effect("lag of the drive", "ms", 0.1, 100.0, lambda arm, ms: {"drive": Drive(time_constant=1e-3 * ms)}),
    Effect("delay of the torque", "periods", 0.1, 50.0, lambda arm, periods: {"drive": Drive(delay=periods)}),
    Effect(
        "delay of the reading",
        "periods",
        0.1,
        50.0,
        lambda arm, periods: {"sensor": Encoder(bits=arm.design.sensor.bits, delay=periods)},
    ),
    Effect("jitter of the reading", "periods", 0.001, 1.0, lambda arm, share: arm.encoder(timing_jitter=share)),
    Effect("stale readings", "per cent", 0.1, 90.0, lambda arm, share: arm.encoder(stale=share / 100)),
    Effect("lost packets", "per cent", 0.1, 90.0, lambda arm, share: arm.encoder(packet_loss=share / 100)),
    Effect("jitter of the period", "periods", 0.05, 0.9, lambda arm, share: {"jitter": share}),
    Effect(
        "limit of the torque's rate",
        "of its own rate",
        1.0,
        0.01,
        lambda arm, share: {"torque_limits": TorqueLimits(rate=share * arm.torque_rate)},
    ),
    Effect(
        "resonance of the joints, encoders at the motors",
        "Hz",
        2 * CONTACT,
        3.0,
        lambda arm, frequency: _gearbox(arm, frequency, 0.0, "motor"),
    ),
    Effect(
        "resonance of the joints, encoders at the links",
        "Hz",
        CONTACT,
        3.0,
        lambda arm, frequency: _gearbox(arm, frequency, 0.0, "link"),
    ),
    Effect(
        "backlash, encoders at the motors",
        "mrad",
        0.01,
        20.0,
        lambda arm, mrad: _gearbox(arm, CONTACT, 1e-3 * mrad, "motor"),
    ),
    Effect(
        "backlash, encoders at the links",
        "mrad",
        0.01,
        20.0,
        lambda arm, mrad: _gearbox(arm, CONTACT, 1e-3 * mrad, "link"),
    ),
)


def measure_arm(robot: Robot, effects: Sequence[Effect] = EFFECTS) -> list[str]:
    """Return the column of an arm: its RMS error [mrad], its torque rate [N m/s] and the limit of each effect."""
    arm = Arm.from_robot(robot)
    return [_spell(1e3 * arm.error, 3), _spell(arm.torque_rate.max(), 3), *(arm.limit(effect) for effect in effects)]


def measure(robots: Sequence[Robot] = ROBOTS) -> str:
    """Return the table of all arms, two at a time."""
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1), mp_context=get_context("spawn")) as pool:
        columns = list(pool.map(measure_arm, robots))
    heads = ["RMS error without [mrad]", "torque rate without [N m/s]", *(f"{e.name} [{e.unit}]" for e in EFFECTS)]
    rows = [[head, *cells] for head, cells in zip(heads, zip(*columns, strict=True), strict=True)]
    return table(["effect", *(robot.name for robot in robots)], rows)


def main() -> None:
    """Measure all arms and write the table."""
    text = measure()
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "limits.md").write_text(f"{text}\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
