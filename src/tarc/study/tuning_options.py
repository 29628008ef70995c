"""How the gains of laws are searched."""

from dataclasses import dataclass
from pathlib import Path

from tarc.core import validation as check


@dataclass(frozen=True, kw_only=True)
class TuningOptions:
    """How the gains of laws are searched.

    Attributes
    ----------
    trials
        Number of sets of gains to try per law.
    seed
        Seed of the sampler.
    margin
        Least robust margin. Only laws are taken whose loop tolerates all inertia ratios of the robot at any rate, with
        this margin. The certificate is that of `certify_varying_ratio`. None for no certificate.
    storage
        File of the trials. A search that was killed goes on from there, and several processes may share it. None for
        none.
    jobs
        Number of processes for several laws; None for one per core. One law is searched in one process.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        For a number of trials or of processes below one, a negative seed, and a margin at or below −1.
    """

    trials: int = 200
    seed: int = 0
    margin: float | None = None
    storage: str | Path | None = None
    jobs: int | None = None
    progress: bool | None = None

    def __post_init__(self) -> None:
        check.integer("trials", self.trials, 1)
        check.integer("seed", self.seed, 0)
        if self.margin is not None:
            check.number("margin", self.margin, -1, strict=True)
        if self.jobs is not None:
            check.integer("jobs", self.jobs, 1)


DEFAULT_OPTIONS = TuningOptions()
