"""The YAML file that describes a run: robot, law, estimator, reference, sensor, disturbance, duration, seed."""

from collections.abc import Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tarc.analysis.watched import watch_workspace
from tarc.analysis.workspace import Workspace
from tarc.control.watch import Watch
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, ScenarioError
from tarc.core.files import save_text
from tarc.core.validation import Numbers
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.scenario.cartesian import CartesianWaypoints
from tarc.scenario.certified_laws import CertifiedLaws, certify_laws
from tarc.scenario.certified_regions import CertifiedRegions, certify_regions
from tarc.scenario.law_builder import build_law, build_laws
from tarc.scenario.loader import (
    apply_setting,
    find_scenario,
    read_scenario,
    relative_files,
    resolve_files,
    use_law,
    use_reference,
)
from tarc.scenario.parts import MeanInertia, Sections, Setup
from tarc.scenario.schema import Component, check_component, scenario_error
from tarc.scenario.user_law import law_name
from tarc.scenario.yaml_text import write_yaml
from tarc.signals.references import Reference
from tarc.simulation.sampled_inputs import scheduled_plants

if TYPE_CHECKING:
    from tarc.simulation.run import Run

SENSOR_EFFECTS = ("delay", "dropout", "packet_loss", "stale", "timing_jitter")
"""Parameters of the encoder that no certificate covers."""


class Scenario(BaseModel):
    """Description of a run, read from YAML by `load` and from a dictionary by `parse`.

    Attributes
    ----------
    name
        Name of the folder of the results.
    robot
        ``file`` (MJCF, URDF or a shipped robot) with the options of `tarc.plants.load_robot`, or ``kind``
        (a class of `tarc.plants`) with its parameters.
    law
        ``kind`` and parameters, or a list of them, to be run side by side. The kind is a class of `tarc.laws`, or
        ``my_file.MyLaw`` for one in a file beside the scenario. ``inertia`` may be one number for all
        joints. With ``{fraction: 0.1}`` it is that fraction of the robot's mean inertia along the reference, and with
        ``diagonal: true`` also, of its diagonal. With ``{model: true, fraction: 0.1}`` it is M̂(q), a
        `tarc.NominalInertia`, and ``feedforward: {model: true}`` is a `tarc.Feedforward`. ``estimator`` replaces the
        scenario's for this law.
    estimator, reference, sensor
        ``kind`` and parameters. The sensor's kind is Encoder; without parameters it is perfect.
    gearbox
        Parameters of `tarc.plants.Gearbox`: elasticity, backlash, friction and ripple between motors and links. The
        simulation has it; certificates and M̂ are those of the robot without it.
    torque_limits
        Parameters of `tarc.signals.TorqueLimits`: the limits of the robot's interface.
    drive
        Parameters of `tarc.signals.Drive`: lag and delay of the torque.
    jitter
        Largest latency of a sampling instant [periods], as in `tarc.simulate`.
    disturbance
        A list of disturbances, payloads and schedules.
    duration, period, metrics_start
        [s]; the measures begin at ``metrics_start``.
    initial_position, initial_velocity, initial_torque
        At the start, as in `tarc.simulate`; torque ``rest`` is the gravity torque.
    acceleration_limits, computation_delay, substeps, seed, native, divergence_threshold
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
    gearbox: dict[str, Any] = Field(default_factory=dict)
    torque_limits: dict[str, Any] = Field(default_factory=dict)
    drive: dict[str, Any] = Field(default_factory=dict)
    jitter: float = 0.0
    disturbance: list[dict[str, Any]] = Field(default_factory=list)
    initial_position: list[float] | None = None
    initial_velocity: float | list[float] = 0.0
    initial_torque: float | list[float] | str = 0.0
    acceleration_limits: float | list[float] | None = None
    period: float = 1e-3
    metrics_start: float = 0.0
    computation_delay: int = 0
    substeps: int | None = None
    seed: int = 0
    native: bool | None = None
    divergence_threshold: float = 5.0

    @classmethod
    def parse(cls, content: object, label: str = "scenario") -> Self:
        """Check a dictionary and return its scenario.

        Raises
        ------
        ScenarioError, InvalidParameter
            For each key at fault: what came and what is allowed. ``path`` is the place of the first one.
        """
        if not isinstance(content, dict):
            kind = type(content).__name__
            raise ScenarioError(f"{label}: got {kind}; needs keys and values, such as robot: and law:")
        try:
            scenario = cls(**content)
        except ValidationError as error:
            raise scenario_error(error, cls, "", label) from None
        _ = scenario.sections
        return scenario

    @classmethod
    def load(cls, path: str | Path, settings: Sequence[str] = (), *, law: str = "", reference: str | Path = "") -> Self:
        """Read a YAML file, or a shipped scenario by name; then apply settings such as ``law.natural_frequency=15``.

        Parameters
        ----------
        path
            The file, or the name.
        settings
            Each ``section.key=value``.
        law
            Kind of a law in place of the scenario's, such as ``my_file.py:MyLaw``, or one of `tarc.laws`. It keeps the
            parameters of the scenario's first law that it has too.
        reference
            File to follow in place of the scenario's reference, for as long as it lasts. It is a ROS 2 bag ``.mcap``
            with one trajectory or with joint states, a trajectory in YAML or JSON, or a record in CSV.

        Raises
        ------
        InvalidParameter
            For a reference that is not there or cannot be read.
        ScenarioError
            For a file that is not there or cannot be read, and as in `parse`.
        """
        file = find_scenario(path)
        content = read_scenario(file)
        if law:
            use_law(content, law)
        if reference:
            use_reference(content, reference)
        for setting in settings:
            apply_setting(content, setting)
        resolve_files(content, file.parent)
        return cls.parse(content, str(file))

    @property
    def laws(self) -> dict[str, dict[str, Any]]:
        """The laws as written, by name: the label or the kind, with a number where two are of the same."""
        laws: dict[str, dict[str, Any]] = {}
        for part in self.law if isinstance(self.law, list) else [self.law]:
            name = kind = str(part.get("label", law_name(str(part.get("kind")))))
            number = 2
            while name in laws:
                name = f"{kind} {number}"
                number += 1
            laws[name] = {key: value for key, value in part.items() if key != "label"}
        return laws

    @cached_property
    def sections(self) -> Sections:
        """The checked parts of the scenario."""
        if not self.laws:
            raise InvalidParameter("law: got an empty list; needs one law or more", "law")
        robot = check_component("robot", self.robot)
        estimator = check_component("estimator", self.estimator)
        laws = {}
        for number, (name, part) in enumerate(self.laws.items()):
            path = f"law.{number}" if isinstance(self.law, list) else "law"
            own = estimator
            if "estimator" in part:
                own = check_component("estimator", part["estimator"], f"{path}.estimator")
            law = check_component("law", {key: value for key, value in part.items() if key != "estimator"}, path)
            laws[name] = law, own
        return Sections(
            robot,
            check_component("reference", self.reference),
            check_component("sensor", {"kind": "Encoder", **self.sensor}),
            self._optional("gearbox", "Gearbox"),
            self._optional("torque_limits", "TorqueLimits"),
            self._optional("drive", "Drive"),
            laws,
            [check_component("disturbance", part) for part in self.disturbance],
        )

    def _optional(self, section: str, kind: str) -> Component | None:
        """Return a section of one kind as a component, or None where it is empty."""
        part = getattr(self, section)
        return check_component(section, {"kind": kind, **part}) if part else None

    def model_copy(self, **options: Any) -> Self:
        """Copy the scenario; its parts are checked again."""
        copied = super().model_copy(**options)
        vars(copied).pop("sections", None)
        return copied

    def with_sections(self, sections: Sections) -> Self:
        """Return the same scenario with other parts, whose keys and types are checked already.

        What it writes as YAML stays that of this one: the parts are for `build` and its like alone.
        """
        copied = self.model_copy()
        vars(copied)["sections"] = sections
        return copied

    def build(self) -> Setup:
        """Construct robot, reference, sensor, disturbances and laws, each once.

        Raises
        ------
        InvalidParameter
            For a parameter that a class refuses, with its place in the scenario as ``path``.
        RobotFileError
            For a robot file that cannot be read.
        """
        plant = self.build_plant()
        reference = self.build_reference(plant).for_run(plant.joint_names, self.duration)
        events = [part.build() for part in self.sections.disturbances]
        mean_inertia = MeanInertia(plant, reference, self.duration)
        laws = build_laws(self.sections.laws, self.period, plant, mean_inertia)
        gearbox, limits, drive = self.sections.gearbox, self.sections.torque_limits, self.sections.drive
        return Setup(
            plant,
            plant if gearbox is None else gearbox.build(plant=plant),
            reference,
            self.sections.sensor.build(),
            None if limits is None else limits.build(),
            None if drive is None else drive.build(),
            events,
            laws,
            mean_inertia,
        )

    @property
    def not_certified(self) -> list[str]:
        """The keys of the scenario whose effect no certificate covers, such as ``gearbox`` and ``jitter``."""
        keys = ["gearbox", "torque_limits", "drive", "jitter"]
        keys = [key for key in keys if getattr(self, key)]
        return [*keys, *(f"sensor.{key}" for key in SENSOR_EFFECTS if np.any(self.sensor.get(key, 0)))]

    def build_plant(self) -> Plant:
        """Construct the robot."""
        return self.sections.robot.build()

    def build_reference(self, plant: Plant | None = None) -> Reference:
        """Construct the reference, if it needs one for a robot: the scenario's, unless it is built already."""
        part = self.sections.reference
        if part.kind is CartesianWaypoints:
            return part.build(robot=plant or self.build_plant())
        return part.build()

    def build_laws(self, plant: Plant, reference: Reference) -> dict[str, Any]:
        """Construct every law on this robot and reference, by name; laws with the same estimator share it."""
        return build_laws(self.sections.laws, self.period, plant, MeanInertia(plant, reference, self.duration))

    def build_law(self, part: dict[str, Any], setup: Setup) -> Law:
        """Construct another law, as the scenario would write it, on parts that are built already.

        Raises
        ------
        ScenarioError, InvalidParameter
            For unknown keys, and for a parameter that the law or its estimator refuses.
        """
        estimator = check_component("estimator", part.get("estimator", self.estimator), "law.estimator")
        options = {key: value for key, value in part.items() if key not in ("estimator", "label")}
        component = check_component("law", options)
        return build_law(component, estimator, self.period, setup.plant, setup.mean_inertia)

    def certify(
        self,
        *,
        tube: float = 0.01,
        full_range: bool = False,
        speed: Numbers | None = None,
        acceleration: Numbers | None = None,
        samples: int = 2000,
        progress: bool | None = None,
    ) -> CertifiedLaws:
        """Certify every law, by name, on the robot with each payload and schedule that it meets.

        A law to which no certificate applies is skipped; the result's ``skipped`` has its name and the reason. A law
        with M̂(q) has its certificate in ``known_inertia``.

        Parameters
        ----------
        tube
            Largest distance of each joint from its reference [rad or m].
        full_range
            Certify for the whole range of the joints, instead of the reference and the tube about it.
        speed
            Largest speed of the joints [rad/s or m/s], one number or one per joint, ``inf`` for any. Default: 1.2 times
            those of the reference, with its accelerations, as in `Workspace.with_reference_speeds`. With
            ``full_range`` the default is any.
        acceleration
            Largest acceleration of the joints [rad/s² or m/s²]. Default: reaches a given speed in 0.25 s.
        samples
            Number of postures to sample.
        progress
            Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

        Raises
        ------
        UnsupportedLaw, NotLinearisable
            Where no certificate applies to any of the laws.
        """
        setup = self.build()
        workspace, plants = self.certified_region(setup, tube, full_range, speed, acceleration)
        return certify_laws(setup, plants, workspace, self.computation_delay, samples=samples, progress=progress)

    def certify_regions(
        self, max_error: Numbers, *, torque_rate: Numbers = 0.0, samples: int = 500, progress: bool | None = None
    ) -> CertifiedRegions:
        """Certify from which errors each law recovers on the nonlinear robot along the reference, by name.

        The robot is that with one of the scenario's payloads throughout. Its dry friction counts as a torque that
        changes at any time. A measured position is off by half a step of the encoder and `NOISE_DEVIATIONS` of its
        noise.

        Parameters
        ----------
        max_error
            Largest error that may ever occur [rad or m], one number or one per joint.
        torque_rate
            Largest rate of a disturbing torque [N m/s or N/s], one number or one per joint.
        samples
            Number of sampled states of the tube.
        progress
            Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

        Raises
        ------
        UnsupportedLaw, NotLinearisable
            Where none of the laws is covered.
        InvalidParameter
            For numbers out of range, and a robot that is not in symbols.
        """
        return certify_regions(
            self.build(),
            self.duration,
            self.computation_delay,
            max_error=max_error,
            torque_rate=torque_rate,
            samples=samples,
            progress=progress,
        )

    def watch(
        self,
        law: str = "",
        *,
        tube: float = 0.01,
        full_range: bool = False,
        speed: Numbers | None = None,
        tolerance: float = 0.1,
    ) -> Watch:
        """Return a watch of what `certify` with the same arguments assumes.

        Parameters
        ----------
        law
            Name of the law whose period is watched; the first without a name.
        tube, full_range, speed
            As in `certify`.
        tolerance
            Largest deviation of the time between two samples over the period.
        """
        setup = self.build()
        workspace, plants = self.certified_region(setup, tube, full_range, speed)
        chosen = law or next(iter(setup.laws))
        check.one_of("law", chosen, list(setup.laws))
        return watch_workspace(workspace, setup.laws[chosen].period, plants, tolerance=tolerance)

    def certified_region(
        self,
        setup: Setup,
        tube: float = 0.01,
        full_range: bool = False,
        speed: Numbers | None = None,
        acceleration: Numbers | None = None,
    ) -> tuple[Workspace, list[Plant]]:
        """Return the workspace of `certify`, and the robot with each payload and schedule that it meets."""
        changes = scheduled_plants(setup.plant, setup.events)
        plants = [plant for start, plant in changes if start < self.duration]
        if full_range:
            return Workspace.from_joint_limits(setup.plant).with_speed_limits(speed, acceleration), plants
        workspace = Workspace.from_reference(setup.reference, self.duration, tube=tube)
        workspace = workspace.with_reference_speeds() if speed is None else workspace.with_speed_limits(speed)
        if acceleration is not None:
            workspace = workspace.with_speed_limits(workspace.speed, acceleration)
        return workspace, plants

    def run(self, progress: bool | None = None) -> dict[str, "Run"]:
        """Simulate every law; return the runs by name."""
        setup = self.build()
        return {name: self.run_law(law, setup, progress) for name, law in setup.laws.items()}

    def run_law(self, law: Law, setup: Setup, progress: bool | None = None) -> "Run":
        """Simulate a law on parts that are built already, such as one of `build_law`."""
        from tarc.simulation.simulator import simulate

        return simulate(
            setup.simulated,
            law,
            setup.reference,
            self.duration,
            sensor=setup.sensor,
            disturbance=setup.events,
            initial_position=self.initial_position,
            initial_velocity=self.initial_velocity,
            initial_torque=self.initial_torque,
            acceleration_limits=self.acceleration_limits,
            computation_delay=self.computation_delay,
            torque_limits=setup.torque_limits,
            drive=setup.drive,
            jitter=self.jitter,
            substeps=self.substeps,
            seed=self.seed,
            native=self.native,
            divergence_threshold=self.divergence_threshold,
            progress=progress,
        )

    def to_yaml(self, folder: str | Path | None = None) -> str:
        """Return the scenario as YAML, without what is at its default.

        Parameters
        ----------
        folder
            Folder of the file to be: files are named from there, and shipped ones by their name. None for the
            working directory.
        """
        content = self.model_dump(mode="json", exclude_defaults=True)
        relative_files(content, Path.cwd() if folder is None else Path(folder))
        return write_yaml(content)

    def save(self, path: str | Path) -> Path:
        """Write the scenario as a YAML file, with file names relative to its folder.

        Raises
        ------
        InvalidParameter
            For a folder that does not exist, and a file that cannot be written.
        """
        return save_text("save", path, self.to_yaml(Path(path).parent))

    def __repr__(self) -> str:
        robot = self.robot.get("file", self.robot.get("kind"))
        return f"<Scenario {self.name}: {', '.join(self.laws)} on {Path(str(robot)).stem}, {self.duration:g} s>"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        return f"<p><b>{escape(self.name)}</b></p><pre>{escape(self.to_yaml())}</pre>"
