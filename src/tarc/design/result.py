"""A designed controller with its reasons and certificates."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tarc.analysis.optimum import OptimumDistance, distance_from_optimum
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.design import writer
from tarc.design.candidates import Candidate, pareto_front
from tarc.design.choice import DesignChoice
from tarc.design.requirements import DesignRequirements
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.scenario.loader import FILE_KEYS
from tarc.scenario.model import Scenario
from tarc.scenario.user_law import relative_kind
from tarc.signals.sensors import Encoder

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """A controller with the reasons for it and its certificates. Its gains are those of ``law``.

    Attributes
    ----------
    requirements
        What the design meets.
    law
        The law, ready for `tarc.simulate` and `tarc.Controller`.
    plants
        The robot with its smallest and its largest payload.
    workspace
        The postures and speeds that are certified.
    certificates
        As `tarc.certify_law` gives them; that of the robot is certified.
    choices
        Every value that was chosen, with its reason, in order.
    shape, spread
        X [kg m² or kg], scaled so that the eigenvalues of M(q)⁻¹X lie between 1 and the spread.
    candidates
        All loops that were assessed.
    candidate
        The loop of the law, with its predicted noise and error.
    torque_noise
        Predicted RMS torque noise, shape (n,) [N m or N].
    """

    requirements: DesignRequirements
    law: TDC | TARC
    plants: tuple[Plant, ...]
    workspace: Workspace
    certificates: dict[str, Certificate]
    choices: tuple[DesignChoice, ...]
    shape: np.ndarray
    spread: float
    candidates: tuple[Candidate, ...]
    candidate: Candidate
    torque_noise: np.ndarray

    @property
    def sensor(self) -> Encoder:
        """The encoder."""
        return self.requirements.sensor

    @property
    def payload(self) -> tuple[float, float]:
        """Smallest and largest payload [kg]."""
        return self.requirements.payload

    @property
    def noise_budget(self) -> float | None:
        """Torque change by noise allowed, over the limit; None where a natural frequency and no budget was required."""
        return self.requirements.noise_target if self.requirements.has_budget else None

    @property
    def torque_change(self) -> np.ndarray:
        """Predicted RMS change of the torque per period by noise, which the budget limits, shape (n,) [N m or N]."""
        return self.torque_noise * self.candidate.change / self.candidate.noise

    @property
    def estimator(self) -> Algebraic:
        """The law's estimator."""
        if not isinstance(self.law.estimator, Algebraic):
            raise InvalidParameter(f"law: its estimator is {self.law.estimator}; a design has an Algebraic one")
        return self.law.estimator

    @property
    def front(self) -> list[Candidate]:
        """Feasible loops of which none has both less torque change by noise and less error, by torque change."""
        return pareto_front(self.candidates)

    @cached_property
    def optimum_distances(self) -> tuple[OptimumDistance, ...]:
        """Distance of the loop from the best linear controller, at the least, middle and largest inertia ratio.

        The disturbing torque is a random walk that adds as much error as the noise of the encoders. A switching gain is
        left out.
        """
        loop, channel = self.candidate, self.candidate.channel()
        ratios = loop.inertia_scale * self.spread ** np.array([0.0, 0.5, 1.0])
        return tuple(
            distance_from_optimum(channel, float(ratio), delay=loop.computation_delay) for ratio in np.unique(ratios)
        )

    def explain(self) -> str:
        """Return every choice with its reason, then the verdict."""
        lines = [f"{choice.label}: {choice.value}\n    {choice.reason}" for choice in self.choices]
        return "\n".join([*lines, "", self.certificates["robot"].explain()])

    def scenario(self, duration: float = writer.DURATION) -> Scenario:
        """Return a scenario for `tarc run`: slow sines about the middle of the workspace.

        The largest payload is picked up at half-time.

        Raises
        ------
        InvalidParameter
            For a robot that is neither from a file nor a class of `tarc.plants`.
        """
        rate = self.requirements.torque_rate
        return Scenario.parse(
            writer.scenario_content(
                self.law, self.plants, self.workspace, self.sensor, self.torque_noise, duration, rate
            )
        )

    def to_yaml(self, *, command: str = "", file: Path | None = None) -> str:
        """Return the scenario as YAML: the reason of each choice above its key, the verdict on top.

        Parameters
        ----------
        command
            The command that made the design, for the first line.
        file
            Where the text is to be written. The files of robot and motion in its folder get relative paths.
        """
        content = self.scenario().model_dump(mode="json", exclude_defaults=True)
        if file is not None:
            for section, key in FILE_KEYS:
                if key in content[section]:
                    content[section][key] = writer.relative_path(Path(content[section][key]), file.parent)
            if self.requirements.has_own_law:
                content["law"]["kind"] = relative_kind(content["law"]["kind"], file.parent)
        options = writer.certify_options(self.plants[0], self.workspace)
        header = writer.header_lines(self.certificates["robot"], options, command, file)
        if self.law.has_model:
            header.append(self._intervals())
        return writer.to_commented_yaml(content, self.choices, header)

    def _intervals(self) -> str:
        """Return for which robots a law with a model is certified."""
        given = self.requirements
        lengths = f" and lengths within {100 * given.length_error:.3g} %" if given.length_error else ""
        return (
            f"This certificate is for rotor inertias within {100 * given.armature_error:.3g} % of the file "
            f"and masses within {100 * given.mass_error:.3g} %{lengths}; tarc certify has those of the file"
        )

    def save(
        self, path: str | Path = "design.yaml", *, figures: "Mapping[str, Figure] | None" = None, command: str = ""
    ) -> list[Path]:
        """Write the scenario, its certificates as JSON and the figures; return the files.

        Parameters
        ----------
        path
            The YAML file, or a folder. The names of the other files begin with its name.
        figures
            By name, such as those of `tarc.plotting.design.design_figures`.
        command
            The command that made the design, for the first line of the file.

        Raises
        ------
        InvalidParameter
            For a path that is no YAML file or cannot be written.
        """
        file = writer.check_writable(path)
        evidence = {kind: json.loads(certificate.to_json()) for kind, certificate in self.certificates.items()}
        texts = {
            file: self.to_yaml(command=command, file=file),
            writer.certificates_path(file): json.dumps(evidence),
        }
        return writer.write_files(file, texts, figures or {})

    def plot(self, kind: str = "front") -> "Figure":
        """Return a figure.

        Parameters
        ----------
        kind
            ``front``: torque change by noise against error of all loops. ``reach``: the spread that each window and
            natural frequency tolerates. ``optimum``: torque variation against error, with the least error of any linear
            controller.
        """
        from tarc.plotting.design import FIGURES

        return FIGURES[check.one_of("kind", kind, FIGURES)](self)
