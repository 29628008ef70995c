"""What happens during a run: payloads, disturbances, changing parameters, saturation and faults."""

import json
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from tarc.core.types import Array
from tarc.signals.disturbances import ParameterSchedule, Payload, payload_schedule


class RunEvent(NamedTuple):
    """An event of a run.

    Attributes
    ----------
    kind
        ``payload``, ``disturbance``, ``parameter`` or ``fault``.
    start_time, stop_time
        [s]; equal for an instant, and at most the end of the run.
    label
        In words, such as ``payload 5 kg``.
    """

    kind: str
    start_time: float
    stop_time: float
    label: str


def run_events(data: xr.Dataset) -> list[RunEvent]:
    """Return the events of a run's dataset in the order of their times; those after its end are left out."""
    end = float(data["time"].values[-1])
    events = []
    for part in json.loads(data.attrs.get("disturbance", "[]")):
        for event in _events_of(part, end):
            if event.start_time <= end and event.stop_time >= 0:
                events.append(event)
    faults = np.flatnonzero(data["fault"].values > 0) if "fault" in data else []
    if len(faults):
        time = float(data["time"].values[faults[0]])
        events.append(RunEvent("fault", time, end, "safe torque"))
    return sorted(events, key=lambda event: event.start_time)


def _events_of(part: dict[str, Any], end: float) -> list[RunEvent]:
    """Return the events of one disturbance, as the dataset describes it."""
    kind = part["kind"]
    start = float(part.get("start_time", 0.0))
    stop = min(float(part.get("stop_time", np.inf)), end)
    if kind == "Payload":
        return [RunEvent("payload", start, stop, f"payload {part['mass']:g} kg")]
    if kind == "ParameterSchedule":
        name = str(part["parameter"])
        times = [float(time) for time in np.ravel(part["times"])]
        stops = [end] if part["interpolate"] else [*times[1:], end]
        return [
            RunEvent("payload" if name == "payload" else "parameter", time, min(last, end), _change(name, part, number))
            for number, (time, last) in enumerate(zip(times, stops, strict=False))
        ]
    words = {"StepDisturbance": "torque step", "SineDisturbance": "torque sine", "ImpulseDisturbance": "torque impulse"}
    return [
        RunEvent("disturbance", start, start if kind == "ImpulseDisturbance" else stop, words.get(kind, "torque noise"))
    ]


def _change(name: str, part: dict[str, Any], number: int) -> str:
    """Return the change of a parameter in words."""
    if part["interpolate"]:
        return f"{name} changes"
    value = part["values"][number]
    if np.ndim(value):
        return f"{name} changes"
    return f"{name} {value:g}" + (" kg" if name == "payload" else "")


def saturated_spans(data: xr.Dataset, merge: float = 0.0) -> list[tuple[float, float]]:
    """Return the intervals of time in which the torque of at least one joint is at its limit, first and last instant.

    Parameters
    ----------
    data
        Dataset of a run.
    merge
        Intervals closer than this are one [s].
    """
    times = data["time"].values
    at_limit = np.abs(data["torque"].values) >= data["torque_limit"].values * (1 - 1e-12)
    places = np.flatnonzero(at_limit.any(axis=1))
    if not len(places):
        return []
    period = float(data.attrs["period"])
    breaks = np.flatnonzero(np.diff(times[places]) > max(merge, 1.5 * period))
    firsts = places[np.concatenate([[0], breaks + 1])]
    lasts = places[np.concatenate([breaks, [len(places) - 1]])]
    return [(float(times[first]), float(times[last])) for first, last in zip(firsts, lasts, strict=True)]


def payload_mass(data: xr.Dataset, times: Array) -> Array:
    """Return the payload [kg] at times (k,), shape (k,), from the description of the robot and of the disturbances."""
    own = float(np.squeeze(json.loads(data.attrs.get("plant", "{}")).get("payload", 0.0)))
    parts = json.loads(data.attrs.get("disturbance", "[]"))
    payloads = [
        Payload(mass=part["mass"], start_time=float(part["start_time"]), stop_time=float(part.get("stop_time", np.inf)))
        for part in parts
        if part["kind"] == "Payload"
    ]
    schedules = [payload_schedule(payloads, own)] if payloads else []
    schedules += [
        ParameterSchedule(**{key: value for key, value in part.items() if key != "kind"})
        for part in parts
        if part["kind"] == "ParameterSchedule" and part["parameter"] == "payload"
    ]
    mass = np.full(len(times), own)
    for schedule in schedules:
        mass = schedule.sample(times, np.array(own))[0]
    return mass
