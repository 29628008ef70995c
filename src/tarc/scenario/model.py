"""The YAML file that describes a run: robot, law, estimator, reference, sensor, disturbance, duration, seed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

import tarc.plants
import tarc.signals
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate
from tarc.certification import certify_law
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.progress import Progress
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.scenario.loader import _Loader, apply_setting, find_scenario
from tarc.scenario.schema import construct, explain, validate
from tarc.simulation.run import Run
from tarc.simulation.sampled_inputs import scheduled_plants
from tarc.simulation.simulator import simulate


class Scenario(BaseModel):
    """A run, described. Read from YAML by `load`, from a dictionary by `parse`.

    Attributes
    ----------
    name
        Names the folder of the results.
    robot
        ``file`` (MJCF, URDF or a shipped robot) with the options of `tarc.plants.MujocoPlant.from_file`, or ``kind``
        (a class of `tarc.plants`) with its parameters.
    law
        ``kind`` and parameters, or a list of them, to be run side by side. ``inertia`` may be one
        number for all joints, or ``{fraction: 0.1}``, of the robot's mean inertia along the reference, with
        ``diagonal: true`` for its diagonal alone; ``estimator`` replaces the scenario's for this law.
    estimator, reference, sensor
        ``kind`` and parameters; the sensor's kind is Encoder, without parameters perfect.
    disturbance
        A list of disturbances, payloads and schedules.
    duration, period, metrics_start
        [s]; the measures leave out what came before ``metrics_start``.
    initial_position, initial_velocity, initial_torque
        At the start, as in `tarc.simulate`; torque ``rest`` is the one that holds the robot.
    computation_delay, substeps, seed, native, divergence_threshold
        As in `tarc.simulate`.
    """

    model_config = ConfigDict(extra="forbid")

    robot: dict[str, Any]
    law: dict[str, Any] | list[dict[str, Any]]
    estimator: dict[str, Any]
    reference: dict[str, Any]
    duration: float
    name: str = "scenario"
    sensor: dict[str, Any] = Field(default_factory=dict)
    disturbance: list[dict[str, Any]] = Field(default_factory=list)
    initial_position: list[float] | None = None
    initial_velocity: float | list[float] = 0.0
    initial_torque: float | list[float] | str = 0.0
    period: float = 1e-3
    metrics_start: float = 0.0
    computation_delay: int = 0
    substeps: int | None = None
    seed: int = 0
    native: bool = False
    divergence_threshold: float = 5.0

    @classmethod
    def parse(cls, content: Any, label: str = "scenario") -> Self:
        """Validate a dictionary; `TarcError` names each key at fault, what came and what is allowed."""
        if not isinstance(content, dict):
            raise TarcError(f"{label}: got {type(content).__name__}; needs keys and values, such as robot: and law:")
        try:
            scenario = cls(**content)
        except ValidationError as error:
            raise TarcError(explain(error, cls, "", label)) from None
        scenario._check()
        return scenario

    @classmethod
    def load(cls, path: str | Path, settings: Sequence[str] = ()) -> Self:
        """Read a YAML file, or a shipped scenario by name; then apply settings such as ``law.natural_frequency=15``."""
        file = find_scenario(path)
        try:
            content = yaml.load(file.read_text(encoding="utf-8"), _Loader)
        except yaml.YAMLError as error:
            raise TarcError(f"{file}: no valid YAML: {error}") from None
        except (OSError, UnicodeDecodeError) as error:
            raise TarcError(f"{file}: cannot be read: {error}") from None
        if not isinstance(content, dict):
            raise TarcError(f"{file}: holds no scenario; needs keys and values, such as robot: and law:")
        content.setdefault("name", file.stem)
        for setting in settings:
            apply_setting(content, setting)
        for section, key in (("robot", "file"), ("reference", "path")):
            part = content.get(section)
            named = part.get(key) if isinstance(part, dict) else None
            if isinstance(part, dict) and isinstance(named, str) and (file.parent / named).is_file():
                part[key] = str((file.parent / named).resolve())
        return cls.parse(content, str(file))

    @property
    def laws(self) -> dict[str, dict[str, Any]]:
        """The laws by a name of their own: the kind, with a number where two are of the same."""
        result: dict[str, dict[str, Any]] = {}
        for part in self.law if isinstance(self.law, list) else [self.law]:
            label = kind = str(part.get("label", part.get("kind")))
            number = 2
            while label in result:
                label, number = f"{kind} {number}", number + 1
            result[label] = {key: value for key, value in part.items() if key != "label"}
        return result

    def _check(self) -> None:
        if isinstance(self.law, list) and not self.law:
            raise TarcError("law: got an empty list; needs one law or more")
        validate("robot", self.robot)
        for number, part in enumerate(self.laws.values()):
            try:
                if "estimator" in part:
                    validate("estimator", part["estimator"])
                validate("law", {key: value for key, value in part.items() if key != "estimator"})
            except TarcError as error:
                if not isinstance(self.law, list):
                    raise
                lines = str(error).splitlines()
                raise TarcError("\n".join(line.replace("law.", f"law.{number}.", 1) for line in lines)) from None
        validate("estimator", self.estimator)
        validate("reference", self.reference)
        validate("sensor", {"kind": "Encoder", **self.sensor})
        for part in self.disturbance:
            validate("disturbance", part)

    def build_plant(self) -> Plant:
        """The robot."""
        options = validate("robot", self.robot)
        if "file" in self.robot:
            return tarc.plants.MujocoPlant.from_file(options.pop("file"), **options)
        return construct("robot", options)

    def build_reference(self) -> tarc.signals.Reference:
        """The reference."""
        return construct("reference", validate("reference", self.reference))

    def build_law(self, part: dict[str, Any], plant: Plant, reference: Any) -> Any:
        """One of the laws, on this robot and reference."""
        part = dict(part)
        own = part.pop("estimator", self.estimator)
        options = validate("law", part)
        inertia = options.get("inertia")
        if isinstance(inertia, dict):
            options["inertia"] = self._fraction(inertia, plant, reference)
        elif isinstance(inertia, int | float):
            options["inertia"] = np.full(plant.n_joints, inertia)
        if options.get("model") is not None:
            check.one_of("law.model", options["model"], ["robot"])
            options["model"] = plant
        estimator = construct("estimator", {**validate("estimator", own), "period": self.period})
        return construct("law", {**options, "period": self.period, "estimator": estimator})

    def _fraction(self, given: dict[str, Any], plant: Plant, reference: Any) -> np.ndarray:
        for key in given:
            if key not in ("fraction", "diagonal"):
                raise TarcError(
                    f"law.inertia.{key}: unknown key; it has fraction and diagonal."
                    f"{check.did_you_mean(str(key), ['fraction', 'diagonal'])}"
                )
        fraction = check.number("law.inertia.fraction", given.get("fraction"), 0, strict=True)
        if reference.n_joints != plant.n_joints:
            raise TarcError(
                f"reference: it has {reference.n_joints} joints, the robot {plant.n_joints} "
                f"({', '.join(plant.joint_names)}); give one number a joint"
            )
        path = reference.sample(np.linspace(0, self.duration, 200))[0]
        mean = plant.mean_inertia(path)
        return fraction * (np.diag(np.diag(mean)) if given.get("diagonal") else mean)

    def build_disturbances(self) -> list[Any]:
        """The disturbances, payloads and schedules."""
        return [construct("disturbance", validate("disturbance", part)) for part in self.disturbance]

    def build_laws(self, plant: Plant, reference: Any) -> dict[str, Any]:
        """Every law, by name."""
        return {name: self.build_law(part, plant, reference) for name, part in self.laws.items()}

    def certify(
        self,
        *,
        tube: float = 0.01,
        full_range: bool = False,
        speed: Numbers | None = None,
        acceleration: Numbers | None = None,
        samples: int = 2000,
        progress: bool | None = None,
    ) -> dict[str, dict[str, Certificate]]:
        """Certify every law, by name and then by kind, on the robot with each payload and schedule that it meets.

        Parameters
        ----------
        tube
            How far each joint may be from its reference [rad or m].
        full_range
            Certify for all that the joints reach, instead of the reference and the tube about it.
        speed
            Greatest speed of the joints [rad/s or m/s], one number or one a joint; None for any.
        acceleration
            And their greatest acceleration [rad/s² or m/s²]; None for that which reaches the speed in a quarter of a
            second.
        samples
            How many postures to sample.
        progress
            Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.
        """
        plant, reference = self.build_plant(), self.build_reference()
        robots = [robot for begin, robot in scheduled_plants(plant, self.build_disturbances()) if begin < self.duration]
        workspace = (
            Workspace.from_joint_limits(plant)
            if full_range
            else Workspace.from_reference(reference, self.duration, tube=tube)
        )
        workspace, laws = workspace.with_speed_limits(speed, acceleration), self.build_laws(plant, reference)
        delay, found = self.computation_delay, {}
        with Progress("certifying", 9 * len(laws), progress) as bar:
            for name, law in laws.items():
                found[name] = certify_law(
                    law, robots, workspace, computation_delay=delay, samples=samples, done=lambda _: bar.advance()
                )
        return found

    def run(self, progress: bool | None = None) -> dict[str, Run]:
        """Simulate every law; by name."""
        plant = self.build_plant()
        reference = self.build_reference()
        sensor = construct("sensor", validate("sensor", {"kind": "Encoder", **self.sensor}))
        events = self.build_disturbances()
        laws = self.build_laws(plant, reference)
        return {
            name: simulate(
                plant,
                law,
                reference,
                self.duration,
                sensor=sensor,
                disturbance=events,
                initial_position=self.initial_position,
                initial_velocity=self.initial_velocity,
                initial_torque=self.initial_torque,
                computation_delay=self.computation_delay,
                substeps=self.substeps,
                seed=self.seed,
                native=self.native,
                divergence_threshold=self.divergence_threshold,
                progress=progress,
            )
            for name, law in laws.items()
        }

    def to_yaml(self) -> str:
        """The scenario as YAML."""
        return yaml.safe_dump(self.model_dump(mode="json", exclude_defaults=True), sort_keys=False, allow_unicode=True)
