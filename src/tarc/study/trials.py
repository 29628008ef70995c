"""Sets of gains tried in all training scenarios: what each trial costs, and what is known of it without a run."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

import numpy as np

from tarc.analysis.linearise import Channel
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.laws.base import Law
from tarc.scenario.model import Scenario
from tarc.study.robust_margin import RobustMargin
from tarc.study.trial_lanes import longest_window, pad_window
from tarc.study.trial_runs import TrialRun, TrialScenario, has_shared_loop, shared_loop
from tarc.study.trial_slopes import SharedSlopes

INSTABILITY = 10.0
"""Added to the objective of a loop that is unstable at rest in a posture of the reference."""
PENALTY = 5.0
"""Factor of log(torque variation / limit) in the objective, where the limit is exceeded."""

REFUSED, NOT_CERTIFIED, UNSTABLE, DIVERGED = "refused", "not certified", "unstable at rest", "diverged"


@dataclass(frozen=True)
class TrialOutcome:
    """What came of a set of gains.

    Attributes
    ----------
    rms_errors, torque_variations
        Of each scenario in which the law ran to the end [rad or m, N m/s or N/s]; those after a failure are left out.
    growth_rates
        Growth rate of the fastest unstable mode at rest in each scenario [1/s]; zero for none.
    margin
        Smallest robust margin over the scenarios; None where none was computed.
    failure
        Why the trial ended early: refused, not certified, unstable at rest, diverged. Empty for none.
    survived
        Number of scenarios before a run diverged, with the share of the last one.
    """

    rms_errors: tuple[float, ...] = ()
    torque_variations: tuple[float, ...] = ()
    growth_rates: tuple[float, ...] = ()
    margin: float | None = None
    failure: str = ""
    survived: float = 0.0

    @property
    def is_stable(self) -> bool:
        """Whether the trial ran to the end and no loop is unstable at rest."""
        return not self.failure and not any(self.growth_rates)

    @property
    def standing(self) -> tuple[int, float]:
        """How far a failed trial came, and how bad the failure is: the later and the less, the better."""
        if self.failure == REFUSED:
            return 0, 0.0
        if self.failure == NOT_CERTIFIED:
            return 1, -(self.margin or 0.0)
        if self.failure == UNSTABLE:
            return 2, max(self.growth_rates)
        return 3 + int(self.survived), -self.survived

    def score(self, limits: Sequence[float]) -> float:
        """Return the mean log RMS error, raised where the torque variation exceeds its limit or the loop is unstable.

        Parameters
        ----------
        limits
            Largest torque variation in each scenario [N m/s or N/s].
        """
        terms = [
            np.log(error) + PENALTY * max(0.0, float(np.log(variation / limit))) + INSTABILITY * (growth > 0)
            for error, variation, growth, limit in zip(
                self.rms_errors, self.torque_variations, self.growth_rates, limits, strict=True
            )
        ]
        return float(np.mean(terms))

    def objectives(self, limits: Sequence[float]) -> tuple[float, float]:
        """Return the mean log RMS error, and the mean log torque variation over its limit."""
        variations = np.log(np.divide(self.torque_variations, limits))
        return float(np.mean(np.log(self.rms_errors))), float(np.mean(variations))

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain data, the same as after a way through JSON."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Self:
        """Return the outcome that `to_dict` wrote."""
        lists = ("rms_errors", "torque_variations", "growth_rates")
        plain: dict[str, Any] = {name: tuple(value) if name in lists else value for name, value in content.items()}
        return cls(**plain)


class Trials:
    """Tries laws in all scenarios in which their kind can run.

    Parameters
    ----------
    scenarios
        Training scenarios.
    min_margin
        Least robust margin; a law below is not run. None for no certificate.
    examples
        Laws for machine code, as in `TrialScenario`.

    Raises
    ------
    InvalidParameter
        As `TrialScenario`.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        min_margin: float | None = None,
        examples: Sequence[dict[str, Any]] = (),
    ):
        self.scenarios = [TrialScenario(scenario, examples) for scenario in scenarios]
        self.min_margin = min_margin
        self._examples = examples
        self._samples = 0
        self._slopes: dict[float, SharedSlopes | None] = {}
        self._margins = [] if min_margin is None else [_margin_in(scenario) for scenario in self.scenarios]

    def evaluate(self, parts: Sequence[dict[str, Any]], run_unstable: bool) -> list[TrialOutcome]:
        """Try some laws: what is cheap to know comes first, and the first failure ends a trial.

        Parameters
        ----------
        parts
            The laws as a scenario writes them.
        run_unstable
            Whether a loop that is unstable at rest is run all the same.
        """
        prepared = [self._without_run(part, run_unstable) for part in parts]
        runs: list[list[TrialRun]] = [[] for _ in parts]
        for number, scenario in enumerate(self.scenarios):
            going = [
                place
                for place, (_, outcome) in enumerate(prepared)
                if not outcome.failure and all(run.completed for run in runs[place])
            ]
            results = scenario.run_all([prepared[place][0][number] for place in going])
            for place, run in zip(going, results, strict=True):
                runs[place].append(run)
        return [_with_runs(outcome, its_runs) for (_, outcome), its_runs in zip(prepared, runs, strict=True)]

    def _without_run(self, part: dict[str, Any], run_unstable: bool) -> tuple[list[Law], TrialOutcome]:
        """Return a law in each scenario, and what is known of it before it is run."""
        laws = [law for scenario in self.scenarios if (law := scenario.build_law(part)) is not None]
        if len(laws) < len(self.scenarios):
            return laws, TrialOutcome(failure=REFUSED)
        channels = self._channels(laws)
        margin = self._margin(laws, channels)
        if margin is not None and self.min_margin is not None and margin < self.min_margin:
            return laws, TrialOutcome(margin=margin, failure=NOT_CERTIFIED)
        growth_rates = tuple(
            scenario.growth_rate(law, loops)
            for scenario, law, loops in zip(self.scenarios, laws, channels, strict=True)
        )
        failure = UNSTABLE if any(growth_rates) and not run_unstable else ""
        return laws, TrialOutcome(growth_rates=growth_rates, margin=margin, failure=failure)

    def margin_of(self, part: dict[str, Any]) -> float:
        """Return the smallest robust margin of a law over the scenarios.

        Raises
        ------
        UnsupportedLaw, NotLinearisable
            For a law that has none.
        """
        margins = self._margins or [_margin_in(scenario) for scenario in self.scenarios]
        laws = [scenario.build_law(part) for scenario in self.scenarios]
        return min(margin.of(law) for margin, law in zip(margins, laws, strict=True) if law is not None)

    def _channels(self, laws: Sequence[Law]) -> list[Sequence[Channel] | None]:
        """Return the linearised loops in each scenario; those of one period and estimator are linearised once."""
        shared: dict[tuple[float, str], Sequence[Channel] | None] = {}
        delayed = []
        for scenario, law in zip(self.scenarios, laws, strict=True):
            key = law.period, repr(law.estimator)
            if key not in shared:
                shared[key] = self._loop(scenario, law)
            loops, delay = shared[key], scenario.scenario.computation_delay
            delayed.append(None if loops is None else [loop.with_delay(delay) for loop in loops])
        return delayed

    def _loop(self, scenario: TrialScenario, law: Law) -> Sequence[Channel] | None:
        """Return the loop that the joints of a law share, by the function of all trials where it covers the law."""
        if law.period not in self._slopes:
            laws = [example for part in self._examples if (example := scenario.build_law(part)) is not None]
            self._samples = longest_window(laws)
            self._slopes[law.period] = _slopes_or_none([pad_window(example, self._samples) for example in laws])
        slopes = self._slopes[law.period]
        if slopes is not None and has_shared_loop(law):
            channel = slopes.channel(pad_window(law, self._samples))
            if channel is not None:
                return [channel]
        return shared_loop(law)

    def _margin(self, laws: Sequence[Law], channels: Sequence[Sequence[Channel] | None]) -> float | None:
        """Return the smallest margin; minus one for a law that has no linearisation."""
        if not self._margins:
            return None
        try:
            pairs = zip(self._margins, laws, channels, strict=True)
            return min(margin.of(law, loops) for margin, law, loops in pairs)
        except (UnsupportedLaw, NotLinearisable):
            return -1.0


def _slopes_or_none(laws: Sequence[Law]) -> SharedSlopes | None:
    """Return what linearises laws like some examples, or None where each is traced by itself."""
    examples = [law for law in laws if has_shared_loop(law)]
    if len(examples) < 2:
        return None
    try:
        return SharedSlopes(examples)
    except (UnsupportedLaw, NotLinearisable):
        return None


def _with_runs(outcome: TrialOutcome, runs: Sequence[TrialRun]) -> TrialOutcome:
    """Return an outcome with the runs, of which the last may have diverged."""
    completed = [run for run in runs if run.completed]
    return replace(
        outcome,
        rms_errors=tuple(run.rms_error for run in completed),
        torque_variations=tuple(run.torque_variation for run in completed),
        failure=outcome.failure if len(completed) == len(runs) else DIVERGED,
        survived=float(sum(run.survived for run in runs)),
    )


def _margin_in(scenario: TrialScenario) -> RobustMargin:
    """Return what computes the margins in a scenario, over the region of `tarc.Scenario.certify`."""
    workspace, plants = scenario.scenario.certified_region(scenario.setup)
    return RobustMargin(plants, workspace, scenario.scenario.computation_delay)
