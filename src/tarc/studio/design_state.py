"""The design that the page shows: one frozen state, to and from the URL and a scenario, with undo and redo."""

import time
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self
from urllib.parse import parse_qsl, urlencode

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter

LAWS = ("TARC", "TDC")
"""Laws that the page shapes."""
RIVALS = ("TDC", "TARC", "PID", "IntelligentPID", "ADRC")
"""Laws to compare with."""
MAX_STATES = 200
"""States that can be undone."""
MERGE_PAUSE = 1.0
"""Longest pause between two moves of a slider that are undone together [s]."""
OBSERVER_SPEED = 5.0
"""Observer bandwidth of ADRC over its natural frequency."""
TORQUE_LIMIT = "torque_limit"
"""Option of a scenario's law that every law of the page keeps, since it belongs to the robot."""


@dataclass(frozen=True)
class Control:
    """A number of the design that a slider moves.

    Attributes
    ----------
    name
        Field of `DesignState`.
    label, unit
        For the page.
    low, high, step
        Range and step of the slider; on a logarithmic one the step is that of the decimal logarithm.
    is_logarithmic
        Whether the slider moves the logarithm.
    is_integer
        Whether the value is a whole number.
    adaptive
        Whether TARC alone has it.
    hint
        What it does, in one sentence.
    """

    name: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    is_logarithmic: bool = False
    is_integer: bool = False
    adaptive: bool = False
    hint: str = ""

    def clip(self, value: float) -> float:
        """Return the nearest value of the range."""
        clipped = min(max(float(value), self.low), self.high)
        return round(clipped) if self.is_integer else clipped


CONTROLS = (
    Control("natural_frequency", "Natural frequency", "rad/s", 2.0, 100.0, 0.01, True, hint="Poles of the error."),
    Control("damping_ratio", "Damping ratio", "", 0.3, 2.0, 0.05, hint="One is critical."),
    Control("window", "Window", "periods", 3, 40, 1, is_integer=True, hint="Samples of the estimator, less one."),
    Control("degree", "Degree", "", 2, 4, 1, is_integer=True, hint="Polynomial that is fitted to the window."),
    Control("delay", "TDE delay", "periods", 1, 9, 1, is_integer=True, hint="Age of the torque in the estimate."),
    Control("inertia_share", "Inertia share", "", 0.005, 2.0, 0.01, True, hint="M̂ over the robot's mean inertia."),
    Control("rise_rate", "Rise rate", "1/s³", 10.0, 1e6, 0.05, True, adaptive=True, hint="Of the switching gain."),
    Control("fall_rate", "Fall rate", "1/s³", 10.0, 1e6, 0.05, True, adaptive=True, hint="Of the switching gain."),
    Control("boundary_layer", "Boundary layer", "", 0.001, 0.2, 0.02, True, adaptive=True, hint="Linear inside."),
    Control("max_gain", "Maximum gain", "rad/s²", 0.1, 50.0, 0.02, True, adaptive=True, hint="Bounds the slope."),
    Control("encoder_bits", "Encoder", "bits", 10, 24, 1, is_integer=True, hint="Per turn."),
    Control("payload", "Payload", "kg", 0.0, 10.0, 0.25, hint="Picked up at half-time."),
    Control("control_rate", "Control rate", "Hz", 250, 4000, 250, is_integer=True, hint="Samples per second."),
)
"""All sliders, in the order of the page."""


@dataclass(frozen=True, kw_only=True)
class DesignState:
    """A design on a robot.

    Attributes
    ----------
    robot
        Name of the robot and its motion, a key of `tarc.studio.robots.Robots`.
    law, rival
        Kind of the law, and of that it is compared with.
    natural_frequency, damping_ratio
        Of the law [rad/s], [-].
    window, delay
        Of the estimator and of time-delay estimation [periods].
    degree
        Of the estimator's polynomial.
    inertia_share
        M̂ over the robot's mean inertia along the reference, or over M(q) with a model.
    model_known
        Whether M̂(q) is that of the robot.
    synchronised
        Whether torque and acceleration of the estimate have the same delay.
    rise_rate, fall_rate, boundary_layer, max_gain
        Of TARC, as in `tarc.laws.TARC`.
    encoder_bits
        Resolution of the encoders.
    payload
        Picked up at half-time [kg].
    control_rate
        Samples per second [Hz].
    """

    robot: str = "two_link_payload"
    law: str = "TDC"
    rival: str = "PID"
    natural_frequency: float = 15.0
    damping_ratio: float = 1.0
    window: int = 10
    degree: int = 2
    delay: int = 1
    inertia_share: float = 0.08
    model_known: bool = False
    synchronised: bool = False
    rise_rate: float = 1e4
    fall_rate: float = 5e3
    boundary_layer: float = 0.015
    max_gain: float = 2.0
    encoder_bits: int = 16
    payload: float = 2.0
    control_rate: int = 1000

    def with_changes(self, **changes: Any) -> Self:
        """Return the state with other values, each within its range.

        Raises
        ------
        InvalidParameter
            For an unknown law or rival.
        """
        for control in CONTROLS:
            if control.name in changes:
                changes[control.name] = control.clip(changes[control.name])
        changed = replace(self, **changes)
        check.one_of("law", changed.law, LAWS)
        check.one_of("rival", changed.rival, RIVALS)
        if changed.window < changed.degree + 1:  # fewer samples have no such polynomial
            changed = replace(changed, window=changed.degree + 1)
        return replace(changed, delay=1) if changed.synchronised else changed

    def to_query(self) -> str:
        """Return what differs from the defaults as the query of a URL."""
        default = DesignState()
        changes = {part.name: getattr(self, part.name) for part in fields(self)}
        changes = {name: value for name, value in changes.items() if value != getattr(default, name)}
        texts = {name: f"{value:.6g}" if isinstance(value, float) else str(value) for name, value in changes.items()}
        return urlencode(texts)

    @classmethod
    def from_query(cls, query: str, start: "DesignState | None" = None) -> tuple[Self, list[str]]:
        """Return the state of a URL's query, and a line for each part of it that is not understood.

        Parameters
        ----------
        query
            The query, without its question mark.
        start
            The state of what the query leaves out; None for the default.
        """
        state = start or cls()
        notes = []
        for name, text in parse_qsl(query):
            try:
                state = state.with_changes(**{name: _parse(name, text)})
            except (InvalidParameter, KeyError, ValueError):
                notes.append(f"{name}={text}: not understood")
        return cls(**vars(state)), notes

    def to_content(self, base: dict[str, Any]) -> dict[str, Any]:
        """Return the design as the content of a scenario.

        Parameters
        ----------
        base
            Content of the scenario with robot, reference and duration. The torque limit of its first law is kept.
        """
        content = {key: value for key, value in base.items() if key not in ("law", "estimator", "disturbance")}
        others = [part for part in base.get("disturbance", []) if part.get("kind") != "Payload"]
        load = {"kind": "Payload", "mass": self.payload, "start_time": base["duration"] / 2}
        content |= {
            "law": self._law(self.law, base),
            "estimator": {"kind": "Algebraic", "window": self.window / self.control_rate, "degree": self.degree},
            "sensor": {**base.get("sensor", {}), "bits": self.encoder_bits},
            "disturbance": [*others, *([load] if self.payload else [])],
            "period": 1 / self.control_rate,
        }
        return content

    def rival_content(self, base: dict[str, Any]) -> dict[str, Any]:
        """Return the same scenario with the rival as its law, on the same natural frequency and damping ratio."""
        return self.to_content(base) | {"law": self._law(self.rival, base)}

    def _law(self, kind: str, base: dict[str, Any]) -> dict[str, Any]:
        part: dict[str, Any] = {
            "kind": kind,
            "inertia": {"fraction": 1.0},  # M̂ is a gain for time-delay estimation, and a model for the others
            "natural_frequency": self.natural_frequency,
            "damping_ratio": self.damping_ratio,
        }
        if kind in LAWS:
            part["inertia"] = {"fraction": self.inertia_share}
            if self.model_known:
                part["inertia"]["model"] = True
            if self.synchronised:
                part["synchronised"] = True
            elif self.delay > 1:
                part["delay"] = self.delay / self.control_rate
        if kind == "TARC":
            names = ("rise_rate", "fall_rate", "boundary_layer", "max_gain")
            part |= {name: getattr(self, name) for name in names}
        if kind == "ADRC":
            part["observer_bandwidth"] = OBSERVER_SPEED * self.natural_frequency
        laws = base.get("law", {})
        first = laws[0] if isinstance(laws, list) else laws
        if TORQUE_LIMIT in first:
            part[TORQUE_LIMIT] = first[TORQUE_LIMIT]
        return part


def _parse(name: str, text: str) -> object:
    """Return the value of a field in a query.

    Raises
    ------
    KeyError, ValueError
        For an unknown field, and for text of another type.
    """
    default = vars(DesignState())[name]
    if isinstance(default, bool):
        return {"True": True, "False": False}[text]
    if isinstance(default, str):
        return text
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(text)
    return value


PRESETS: dict[str, dict[str, Any]] = {
    "Calm": {"law": "TDC", "natural_frequency": 8.0, "damping_ratio": 1.0, "window": 16, "inertia_share": 0.05},
    "Balanced": {"law": "TDC", "natural_frequency": 15.0, "damping_ratio": 1.0, "window": 10, "inertia_share": 0.08},
    "Stiff": {"law": "TDC", "natural_frequency": 35.0, "damping_ratio": 1.0, "window": 7, "inertia_share": 0.12},
    "Adaptive": {"law": "TARC", "natural_frequency": 15.0, "window": 10, "inertia_share": 0.08, "max_gain": 2.0},
    "Too eager": {"law": "TDC", "natural_frequency": 25.0, "window": 10, "inertia_share": 0.6},
}
"""Designs to start from, by name; the last is unstable on purpose."""


@dataclass
class History:
    """The states of a session, for undo and redo.

    Attributes
    ----------
    state
        The present one.
    """

    state: DesignState = field(default_factory=DesignState)
    _past: list[DesignState] = field(default_factory=list)
    _future: list[DesignState] = field(default_factory=list)
    _merge_key: str = ""
    _merge_time: float = 0.0

    def move(self, state: DesignState, merge_key: str = "") -> None:
        """Make a state the present one; moves with the same key soon after each other, as of a slider, are one."""
        if state == self.state:
            return
        now = time.monotonic()
        if not merge_key or merge_key != self._merge_key or now > self._merge_time + MERGE_PAUSE:
            self._past = [*self._past, self.state][-MAX_STATES:]
        self._merge_key = merge_key
        self._merge_time = now
        self._future = []
        self.state = state

    @property
    def can_undo(self) -> bool:
        """Whether there is a state before."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether there is a state that was undone."""
        return bool(self._future)

    def undo(self) -> DesignState:
        """Return to the state before, if there is one."""
        if self._past:
            self._future.append(self.state)
            self.state = self._past.pop()
            self._merge_key = ""
        return self.state

    def redo(self) -> DesignState:
        """Return to the state that was undone last, if there is one."""
        if self._future:
            self._past.append(self.state)
            self.state = self._future.pop()
            self._merge_key = ""
        return self.state
