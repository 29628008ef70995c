"""A simulation's raw output as a labelled dataset."""

import json
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import xarray as xr

from tarc.control.digital_controller import DigitalController
from tarc.core.array_ops import HUGE
from tarc.core.units import joint_units, unit_for_joints
from tarc.core.version import __version__
from tarc.plants.base import Plant
from tarc.signals.drive import Drive
from tarc.signals.references import Reference
from tarc.simulation.quantities import VARIABLES
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import SampledInputs


def dataset(
    plant: Plant,
    controller: DigitalController,
    reference: Reference,
    inputs: SampledInputs,
    record: Record,
    divergence_index: int | None,
    seed: int,
    drive: Drive | None = None,
) -> xr.Dataset:
    """Label a record: variables with names and units over time and joint, and how the run was made as attributes.

    Parameters
    ----------
    plant, controller, reference, inputs, seed, drive
        As simulated.
    record
        Raw output.
    divergence_index
        Sample at which the run diverged, or None.
    """
    arrays = with_derived_signals(record, controller, inputs)
    n_samples = len(arrays["position"])
    order = list(VARIABLES)
    passive_units = [plant.coordinate_units[i] for i in plant.unmeasured]
    torque_unit = joint_units(plant.torque_units)
    variables = {}
    for name in sorted(arrays, key=lambda name: order.index(name) if name in order else len(order)):
        label, unit = VARIABLES.get(name, (name.replace("_", " "), "1"))
        attributes = {"long_name": label, "units": unit_for_joints(unit, plant.units)}
        dimensions: tuple[str, ...] = ("time",) if arrays[name].ndim == 1 else ("time", "joint")
        if name in ("passive_position", "passive_velocity"):
            dimensions = ("time", "passive_joint")
            attributes["units"] = unit_for_joints(unit, passive_units)
        if name == "torque":
            attributes = _torque_attributes(label, torque_unit)
        variables[name] = (dimensions, arrays[name], attributes)
    variables |= _limits(controller, torque_unit)
    coordinates = {
        "time": ("time", inputs.times[:n_samples], {"units": "s", "long_name": "time"}),
        "joint": ("joint", plant.joint_names),
        "joint_unit": ("joint", plant.units, {"long_name": "unit of the joint's position"}),
    }
    if plant.unmeasured:
        coordinates["passive_joint"] = ("passive_joint", [plant.coordinate_names[i] for i in plant.unmeasured])
    attributes = {
        "title": f"{type(controller.law).__name__} on {plant.label}",
        "source": f"tarc-control {__version__}",
        "plant": to_json(describe(plant)),
        "law": to_json(describe(controller.law)),
        "reference_signal": to_json(describe(reference)),
        "sensor": to_json(describe(controller.sensor)),
        "drive": "" if drive is None else to_json(describe(drive)),
        "torque_limits": "" if controller.torque_limits is None else to_json(describe(controller.torque_limits)),
        "disturbance": to_json([describe(event) for event in inputs.events]),
        "period": controller.law.period,
        "substeps": inputs.disturbance.shape[2],
        "computation_delay": controller.computation_delay,
        "seed": seed,
        "duration": len(inputs.times) * controller.law.period,
        "divergence_time": np.nan if divergence_index is None else inputs.times[divergence_index],
    }
    return xr.Dataset(variables, coords=coordinates, attrs=attributes)


def _limits(controller: DigitalController, torque_unit: str) -> dict[str, Any]:
    """Return the limits of the torque and of its rate, as variables."""
    limits, interface = largest_torques(controller), controller.torque_limits
    label = {"long_name": "largest torque that is applied", "units": torque_unit}
    variables = {"torque_limit": ("joint", limits, label)}
    if interface is not None and interface.rate is not None:
        rates = np.broadcast_to(np.asarray(interface.rate, dtype=float), limits.shape)
        label = {"long_name": "largest rate of the torque", "units": f"{torque_unit}/s".replace("/s/s", "/s²")}
        variables["torque_rate_limit"] = ("joint", rates, label)
    return variables


def largest_torques(controller: DigitalController) -> np.ndarray:
    """Return the largest torque of each joint that passes the limits [N m or N], (n,); infinite for none."""
    limits = controller.law.torque_limits
    if controller.torque_limits is not None:
        limits = np.minimum(limits, controller.torque_limits.magnitudes(controller.law.n_joints))
    return np.where(limits < HUGE, limits, np.inf)


def _torque_attributes(label: str, unit: str) -> dict[str, str]:
    """Return name and unit of what the law outputs: torques, or commands of inner loops."""
    return {"long_name": label if unit.startswith("N") else "command of the joints", "units": unit}


def with_derived_signals(record: Record, controller: DigitalController, inputs: SampledInputs) -> dict[str, np.ndarray]:
    """Return the recorded arrays with the reference, the TDE error and the noise-free ‖s‖."""
    arrays = dict(record.arrays)
    n_samples = len(arrays["position"])
    names = ("reference", "velocity_reference", "acceleration_reference")
    for name, values in zip(names, inputs.reference, strict=True):
        arrays[name] = values[:, :n_samples].T
    if "auxiliary" in arrays:
        is_tracking = np.reshape(arrays["fault"] == 0, (-1, 1))  # after a fault, u is not what is applied
        arrays["tde_error"] = np.where(is_tracking, arrays["acceleration"] - arrays["auxiliary"], np.nan)
    error = arrays["position"] - arrays["reference"]
    error_rate = arrays["velocity"] - arrays["velocity_reference"]
    sliding = controller.law.sliding(error.T, error_rate.T)
    if sliding is not None:
        arrays["sliding"] = np.linalg.norm(np.asarray(sliding), axis=0)
    return arrays


def to_json(content: object) -> str:
    """Return the JSON of a description, with arrays as lists and infinities as text."""

    def plain(value: object) -> object:
        if isinstance(value, np.ndarray | np.generic):
            return plain(value.tolist())
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple | range):
            return [plain(item) for item in value]
        if isinstance(value, float) and not np.isfinite(value):
            return str(value)
        return value if value is None or isinstance(value, int | float | str) else str(value)

    return json.dumps(plain(content))


def describe(part: object) -> dict[str, Any]:
    """Return kind and parameters of a component, ready for JSON."""
    result: dict[str, Any] = {"kind": type(part).__name__}
    if is_dataclass(part):
        for field in fields(part):
            value = getattr(part, field.name)
            if is_dataclass(value):
                value = describe(value)
            if value is not None:
                result[field.name] = value
    elif isinstance(part, Plant):
        result |= {"file": part.label, **{name: value.tolist() for name, value in part.parameters.items()}}
    return result
