"""Draws that are numbers of the robot or noise of the encoder: handed to the compiled loop without building parts."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.sensors import Encoder
from tarc.simulation.varying import replaced
from tarc.study.cases import Cases
from tarc.study.drawn_keys import DrawnKey, value_at

PACKAGE = "tarc.plants."
"""Module of plants whose parameters are valid one by one, but for an inertia matrix that is checked."""


@dataclass(frozen=True, eq=False)
class DirectRun:
    """Numbers of one run: parameters of the plant by name, the encoder, and the values that both have, by key."""

    parameters: dict[str, Array]
    sensor: Encoder
    applied: dict[str, float]


class DirectDraws:
    """Puts drawn values into the parameters of the scenario's robot and its encoder.

    Some runs are built too, and must have the same numbers. These are the first one, and those with the least and the
    greatest value of each key. The inertia matrices of all runs must be positive definite.

    Parameters
    ----------
    cases
        What builds parts.
    """

    def __init__(self, cases: Cases):
        self._cases = cases
        plant = cases.nominal.simulated
        assert isinstance(plant, SymbolicPlant)
        self.plant = plant

    @staticmethod
    def is_possible(cases: Cases) -> bool:
        """Return whether all drawn keys are parameters of a robot of the package, or noise of the encoder."""
        plant = cases.nominal.simulated
        is_of_package = type(plant).__module__.startswith(PACKAGE) and cases.scenario.sections.gearbox is None
        return (
            is_of_package
            and not cases.has_known
            and not any(one.texts for one in cases.distributions)
            and all(key.section == "robot" or _is_noise(key) for key in cases.keys)
        )

    def runs(self, rows: Array) -> list[DirectRun]:
        """Return the numbers of the runs of some rows of values, (runs, keys).

        Raises
        ------
        InvalidParameter
            For a value that a part refuses, and an inertia matrix that is not positive definite.
        """
        runs = [self._run(row) for row in rows]
        for number in np.unique([0, *np.argmin(rows, axis=0), *np.argmax(rows, axis=0)]):
            case = self._cases.build(rows[number])
            built, ours = case.setup.simulated.parameters, runs[number].parameters
            if any(not np.array_equal(built[name], value) for name, value in ours.items()):
                raise InvalidParameter(f"draws: the robot with {ours} has other parameters")
        self._check_inertias(runs)
        return runs

    def _run(self, row: Array) -> DirectRun:
        """Return the numbers of one run."""
        nominal = self._cases.nominal
        parameters: dict[str, Array] = {}
        noise: Any = nominal.sensor.noise
        for key, value in zip(self._cases.keys, row, strict=True):
            if _is_noise(key):
                noise = _with_noise(noise, key, float(value), self.plant.n_joints)
                continue
            name = str(key.path[0])
            array = parameters.setdefault(name, np.array(self.plant.parameters[name]))
            array[tuple(int(step) for step in key.path[1:]) or ...] = value
        sensor = replaced(nominal.sensor, {("noise",): noise}) if noise is not nominal.sensor.noise else nominal.sensor
        applied = {
            key.name: value_at(sensor.noise, key.path[1:])
            if _is_noise(key)
            else value_at(parameters[str(key.path[0])], key.path[1:])
            for key in self._cases.keys
        }
        return DirectRun(parameters, sensor, applied)

    def _check_inertias(self, runs: list[DirectRun]) -> None:
        """Refuse an inertia matrix that is not positive definite, as robots from energies do."""
        names = list(runs[0].parameters)
        if not names or not isinstance(self.plant, EulerLagrange):
            return
        n, q = self.plant.n_coordinates, np.linspace(0.1, 1.1, self.plant.n_coordinates)
        values = {name: np.array([np.ravel(run.parameters[name]) for run in runs]).T for name in names}
        matrices = self.plant.evaluate("inertia", np.tile(q[:, None], len(runs)), parameters=values)
        inertias = matrices.T.reshape(len(runs), n, n)
        if not np.all(np.isfinite(inertias)) or np.min(np.linalg.eigvalsh(inertias)[:, 0]) <= 0:
            raise InvalidParameter(
                f"draws: the inertia matrix of {self.plant.label} is not positive definite for one of the runs; "
                "draw positive masses and inertias"
            )


def _is_noise(key: DrawnKey) -> bool:
    return key.section == "sensor" and key.path[0] == "noise"


def _with_noise(noise: Any, key: DrawnKey, value: float, n_joints: int) -> Any:
    """Return the noise of the encoder with a drawn value: one number, or one per joint."""
    if len(key.path) == 1:
        return value
    values = np.full(n_joints, noise, dtype=float) if np.ndim(noise) == 0 else np.array(noise, dtype=float)
    values[int(key.path[1])] = value
    return values
