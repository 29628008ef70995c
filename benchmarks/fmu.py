"""What a co-simulation costs: ``python -m benchmarks.fmu``, part of ``make bench-export``.

Each law is exported as an FMU. FMPy runs it against a two-link arm that Python integrates: in co-simulation, in model
exchange with time events, and in co-simulation of FMI 3.0 with event mode. Beside them stands the simulation of the
package with the same plant, without and with one period of computation delay. The motions are compared bit by bit.
For each law and way it prints the largest error after the first second [mrad], and the root mean square of the torque's
change from one period to the next [N m]. Then it prints the largest stable ratio of M̂ to the inertia, at once and late.
"""

import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Slave
from rich.console import Console
from rich.table import Table

import tarc
from benchmarks.__main__ import machine
from tarc.analysis import stable_interval
from tarc.core.errors import NoStableRatio
from tarc.core.types import Array
from tarc.export import export_fmu
from tarc.simulation.closed_loop import runge_kutta

PERIOD = 1e-3
DURATION = 4.0
SETTLED = 1.0
"""Time from which errors count [s]."""
SUBSTEPS = 2
BITS = 16
"""Of the encoders of the second table."""
FRACTION = 0.08
"""M̂ over the inertia."""
INPUTS = ("position", "reference", "velocity_reference", "acceleration_reference")
DIVERGED = 5.0
"""Error beyond which a run ends [rad], as in `simulate`."""
VERSIONS = ("2.0", "3.0")
WAYS = ("model exchange", "co-simulation", "event mode")


@dataclass(frozen=True)
class Loop:
    """The plant, the reference's samples, each (periods, 2), the start, and the encoder's step [rad], 0 for none."""

    plant: tarc.plants.TwoLinkArm
    references: tuple[Array, Array, Array]
    position: Array
    torque: Array
    step_size: float


def plant_step(plant: tarc.plants.TwoLinkArm) -> Callable[..., tuple[Array, Array]]:
    """Return one period of the plant with the torque held, as `simulate` integrates it."""
    q, dq, torque = (ca.SX.sym(name, 2) for name in ("q", "dq", "torque"))
    end, end_velocity = q, dq
    for _ in range(SUBSTEPS):
        end, end_velocity, _ = runge_kutta(plant, end, end_velocity, torque, PERIOD / SUBSTEPS)
    function = ca.Function("plant", [q, dq, torque], [end, end_velocity], {"cse": True})

    def step(*values: Array) -> tuple[Array, Array]:
        position, velocity = function(*values)
        return np.array(position).ravel(), np.array(velocity).ravel()

    return step


class Instance:
    """An FMU in FMPy, stepped by one of `WAYS`."""

    def __init__(self, file: Path, way: str):
        self.way = way
        description = read_model_description(str(file))
        kind = {"co-simulation": FMU2Slave, "model exchange": FMU2Model, "event mode": FMU3Slave}[way]
        self.fmu = kind(
            guid=description.guid,
            unzipDirectory=extract(str(file)),
            modelIdentifier=file.stem,
            instanceName="law",
        )
        self.places: dict[str, list[int]] = {}
        for variable in description.modelVariables:
            self.places.setdefault(variable.name.partition("[")[0], []).append(variable.valueReference)
        self.fmu.instantiate(**({"eventModeUsed": True} if way == "event mode" else {}))

    def _set(self, name: str, values: Array) -> None:
        setter = self.fmu.setFloat64 if self.way == "event mode" else self.fmu.setReal
        setter(self.places[name], values.tolist())

    def _torque(self) -> Array:
        if self.way == "event mode":
            return np.array(self.fmu.getFloat64(self.places["torque"], 2))
        return np.array(self.fmu.getReal(self.places["torque"]))

    def start(self, torque: Array) -> None:
        """Start with a torque applied."""
        if self.way == "event mode":
            self.fmu.enterInitializationMode(startTime=0.0)
        else:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        self._set("initial_torque", torque)
        self.fmu.exitInitializationMode()

    def step(self, k: int, *inputs: Array) -> Array:
        """Return the torque that acts in period k, whose samples are the inputs."""
        time, acting = k * PERIOD, self._torque()
        if self.way == "model exchange" and k:
            self.fmu.setTime(time)
            self.fmu.enterEventMode()
        for name, values in zip(INPUTS, inputs, strict=True):
            self._set(name, values)
        if self.way == "co-simulation":
            self.fmu.doStep(time, PERIOD)
            return acting
        update = self.fmu.updateDiscreteStates if self.way == "event mode" else self.fmu.newDiscreteStates
        while update()[0]:
            pass
        acting = self._torque()
        if self.way == "event mode":
            self.fmu.enterStepMode()
            self.fmu.doStep(time, PERIOD)
            self.fmu.enterEventMode()
        else:
            self.fmu.enterContinuousTimeMode()
        return acting


class Motion(NamedTuple):
    """Positions at the samples and torques that acted after them, each (periods, 2)."""

    position: Array
    torque: Array

    def errors(self, reference: Array) -> str:
        """Return the largest error after the start [mrad] and the torque's change in a period, rms [N m]."""
        if not np.all(np.isfinite(self.position)) or len(self.position) < len(reference):
            return f"diverges at {len(self.position) * PERIOD:.2f} s"
        first = round(SETTLED / PERIOD)
        change = np.sqrt(np.mean(np.diff(self.torque[first:], axis=0) ** 2))
        return f"{1e3 * np.max(np.abs(self.position - reference)[first:]):.2f}, {change:.2g}"


def in_fmpy(file: Path, way: str, loop: Loop) -> Motion:
    """Return the motion; it ends where the error diverges."""
    instance, step = Instance(file, way), plant_step(loop.plant)
    instance.start(loop.torque)
    q, dq = loop.position, np.zeros(2)
    positions, torques = [], []
    for k, references in enumerate(zip(*loop.references, strict=True)):
        if np.linalg.norm(q - references[0]) > DIVERGED:
            break
        measured = loop.step_size * np.floor(q / loop.step_size + 0.5) if loop.step_size else q
        positions.append(q)
        torques.append(instance.step(k, measured, *references))
        q, dq = step(q, dq, torques[-1])
    instance.fmu.terminate()
    instance.fmu.freeInstance()
    return Motion(np.array(positions), np.array(torques))


def in_simulation(law: tarc.laws.Law, loop: Loop, reference: tarc.signals.Reference, delay: int) -> Motion:
    """Return the motion of the package's own simulation."""
    sensor = tarc.signals.Encoder(resolution=loop.step_size) if loop.step_size else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tarc.DesignWarning)
        run = tarc.simulate(
            loop.plant,
            law,
            reference,
            DURATION,
            sensor=sensor,
            initial_torque=loop.torque,
            computation_delay=delay,
            substeps=SUBSTEPS,
            divergence_threshold=DIVERGED,
        )
    return Motion(run.data["position"].to_numpy(), run.data["torque"].to_numpy())


def laws(inertia: Array) -> Iterator[tuple[str, tarc.laws.Law]]:
    """Return the laws that are compared, each as it is and with one period of actuation delay."""
    options: dict[str, Any] = {
        "inertia": FRACTION * inertia,
        "natural_frequency": 15.0,
        "period": PERIOD,
        "estimator": tarc.estimators.Algebraic(window=0.010),
    }
    adaptive: dict[str, Any] = {"rise_rate": 3000.0, "fall_rate": 2000.0, "boundary_layer": 0.01}
    chosen: dict[str, tarc.laws.Law] = {
        "TDC, literal": tarc.laws.TDC(**options),
        "TARC, literal": tarc.laws.TARC(**options, **adaptive),
        "TDC, synchronised": tarc.laws.TDC(**options, synchronised=True),
    }
    for name, law in chosen.items():
        for delay in (0, 1):
            yield f"{name}, actuation_delay={delay}", replace(law, actuation_delay=delay)


def table_of(step_size: float) -> Table:
    """Return the errors of each law by way, and whether the motions are those of the simulation."""
    plant = tarc.plants.TwoLinkArm(viscous=[0.5, 0.5])
    reference = tarc.signals.Multisine(amplitude=[0.3, 0.25], frequency=[1.0, 2.3], offset=[0.0, 1.5])
    q, dq, ddq = (part.T for part in reference.sample(PERIOD * np.arange(round(DURATION / PERIOD))))
    references, position = (q, dq, ddq), q[0]
    loop = Loop(plant, references, position, plant.holding_torque(position), step_size)
    table = Table("law", "model exchange", "co-simulation", "FMI 3.0, event mode", "as simulated", "stable up to")
    for name, law in laws(plant.inertia(np.array([0.0, 1.5]))):
        with tempfile.TemporaryDirectory() as folder:
            files = {
                fmi: export_fmu(law, Path(folder) / f"law{fmi[0]}.fmu", name=f"law{fmi[0]}", fmi=fmi, tunable=[]).file
                for fmi in VERSIONS
            }
            found = {way: in_fmpy(files["3.0" if way == "event mode" else "2.0"], way, loop) for way in WAYS}
        own = [in_simulation(law, loop, reference, delay) for delay in (0, 1)]
        expected = {"model exchange": own[0], "co-simulation": own[1], "event mode": own[0]}
        same = all(is_same(found[way], expected[way]) for way in WAYS)
        stable = ", ".join(largest_ratio(law, delay) for delay in (0, 1))
        table.add_row(name, *(one.errors(references[0]) for one in found.values()), "yes" if same else "NO", stable)
    return table


def largest_ratio(law: tarc.laws.Law, delay: int) -> str:
    """Return the largest stable ratio of M̂ to the inertia."""
    try:
        return f"{stable_interval(law, computation_delay=delay)[1]:.3f}"
    except NoStableRatio:
        return "none"


def is_same(found: Motion, expected: Motion) -> bool:
    """Whether every bit of two motions is the same, as far as both go."""
    count = min(len(found.position), len(expected.position))
    return all(np.array_equal(one[:count], other[:count]) for one, other in zip(found, expected, strict=True))


def report(console: Console) -> None:
    """Print errors and differences, without and with encoders."""
    for bits in (0, BITS):
        sensor = f"encoders of {bits} bits" if bits else "positions as they are"
        title = "largest error [mrad], change of the torque in a period, rms [N m]; largest stable ratio at once, late"
        console.print(f"\nFMU and two-link arm, {sensor}: {title}", highlight=False, markup=False)
        console.print(table_of(2 * np.pi / 2**bits if bits else 0.0))


def main() -> None:
    """Print everything; it reports, so that it exits with 0 whatever the numbers are."""
    console = Console(width=None if Console().is_terminal else 170)
    console.print(machine(), highlight=False)
    report(console)


if __name__ == "__main__":
    main()
