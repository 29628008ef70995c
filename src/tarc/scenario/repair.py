"""Settings of a scenario with which a law that was not certified is certified: each is tried."""

import copy
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice
from typing import Any

import numpy as np

from tarc.analysis.linearise import joints_share_loop
from tarc.analysis.operating_points import RADIUS_SHARES, SEARCH_MARGIN
from tarc.analysis.stability import stable_intervals, widest_interval
from tarc.certificates.affine import ORDERS
from tarc.certificates.ball import Ball
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.certificates.varying_ratio import widest_ball
from tarc.certification import LawCertification
from tarc.core.errors import NoStableRatio
from tarc.core.progress import Progress
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.scenario.certified_laws import CertifiedLaws
from tarc.scenario.loader import apply_setting
from tarc.scenario.model import Scenario

FREQUENCY_FACTORS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Factors of the natural frequency that are tried, the smallest change first."""

MAX_TRIALS = 6
"""Most changes that are certified by a ball."""

MAX_SEARCHES = 4
"""Most changes for which a Lyapunov function is searched, where no ball certifies one; each takes seconds."""

PLACE = 0.7
"""Where the scale of M̂ is then, on the logarithmic scale between those that constant ratios admit. A larger one decays
faster and leaves less room."""

MIN_SPREAD_SHARE = (1 + SEARCH_MARGIN) ** 2 / (1 - RADIUS_SHARES[0])
"""Least spread that a loop must tolerate to be tried, over that of the robot.

The robot's certificate covers more by the margin of the search. It leaves a least share of the smallest ratio to
stiffness and damping.
"""


def certifying_settings(
    scenario: Scenario, certified: CertifiedLaws, name: str, *, progress: bool | None = None
) -> list[str]:
    """Return the smallest change of a law that the certificate of the robot certifies; empty where none was found.

    M̂ is moved to the middle of the ratios that the loop tolerates. Where that does not suffice, synchronised time-delay
    estimation is tried, then lower natural frequencies. For TARC the largest gain is lowered with their square. Where
    no ball certifies any of these, a Lyapunov function affine in the inertia is searched for them. Each change is
    certified with the numbers that are returned, on the same robot, postures and samples.

    Parameters
    ----------
    scenario
        The scenario.
    certified
        Result of `Scenario.certify`.
    name
        A law in it.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    list
        Settings as `Scenario.load` takes them, such as ``law.inertia.fraction=0.44``.
    """
    law, part = certified[name].law, scenario.laws[name]
    if not joints_share_loop(law) or not np.isfinite(law.robust_slope_bound) or "inertia" not in part:
        return []
    place = f"law.{list(scenario.laws).index(name)}" if isinstance(scenario.law, list) else "law"
    by_ball = islice(_changes(law, part, certified, name), MAX_TRIALS)
    by_search = islice(_changes_in_room(law, part, certified, name), MAX_SEARCHES)
    with Progress("settings that certify", MAX_TRIALS + MAX_SEARCHES, progress) as bar:
        for changes, is_searched in chain(((one, False) for one in by_ball), ((one, True) for one in by_search)):
            settings = [f"{place}.{change}" for change in changes]
            if _is_certified(scenario, certified, name, settings, is_searched=is_searched):
                return settings
            bar.advance()
    return []


def _changes(law: PolePlacement, part: dict[str, Any], certified: CertifiedLaws, name: str) -> Iterator[list[str]]:
    """Yield changes of a law whose loop tolerates the robot's spread, the smallest first."""
    robot = certified[name].verdict.evidence
    centre = (robot.min_ratio * robot.max_ratio) ** 0.5
    for factor, variant, settings in _variants(law, part):
        ball = _tolerated(variant, certified[name], is_as_it_was=factor == 1.0)
        if ball is None or ball.ratio_spread < MIN_SPREAD_SHARE * robot.ratio_spread:
            continue
        scale = (ball.min_ratio * ball.max_ratio) ** 0.5 / centre
        yield [_scaled_inertia(part["inertia"], scale), *settings]


def _changes_in_room(
    law: PolePlacement, part: dict[str, Any], certified: CertifiedLaws, name: str
) -> Iterator[list[str]]:
    """Yield changes of a law whose loop is stable at each constant ratio of the robot, the smallest first."""
    robot = certified[name].verdict.evidence
    for _, variant, settings in _variants(law, part):
        stable = widest_interval(stable_intervals(variant, computation_delay=certified[name].computation_delay))
        if stable is None:
            continue
        low, high = stable[0] / robot.min_ratio, stable[1] / robot.max_ratio
        if high > (1 + SEARCH_MARGIN) ** 2 * low:
            yield [_scaled_inertia(part["inertia"], low * (high / low) ** PLACE), *settings]


def _variants(law: PolePlacement, part: dict[str, Any]) -> Iterator[tuple[float, PolePlacement, list[str]]]:
    """Yield laws with lower natural frequencies, each also synchronised where it can be, and the settings of each."""
    literal = isinstance(law, TDE) and law.uses_tde and not law.synchronised
    for factor in FREQUENCY_FACTORS:
        if factor < 1 and np.ndim(part.get("natural_frequency", [])) > 0:
            return
        for synchronised in (False, True) if literal else (False,):
            yield factor, *_variant(law, part, factor, synchronised)


def _tolerated(variant: PolePlacement, certification: LawCertification, is_as_it_was: bool) -> Ball | None:
    """Return the widest ball of a changed law at the robot's rate; None where no ratio is stable.

    That of a law whose gains are as they were is known already.
    """
    if is_as_it_was:
        return certification.tolerated.get(isinstance(variant, TDE) and variant.synchronised)
    try:
        return widest_ball(
            variant,
            slope=variant.robust_slope_bound,
            rate=certification.verdict.evidence.rate,
            computation_delay=certification.computation_delay,
        )
    except NoStableRatio:
        return None


def _variant(
    law: PolePlacement, part: dict[str, Any], factor: float, synchronised: bool
) -> tuple[PolePlacement, list[str]]:
    """Return a law with a lower natural frequency, or synchronised, and the settings that make it."""
    changes: dict[str, Any] = {}
    if synchronised:
        changes |= {"synchronised": True, "delay": None}
    if factor < 1:
        changes["natural_frequency"] = _rounded(factor * part["natural_frequency"])
        if isinstance(law, TARC) and law.max_gain is not None:
            changes["max_gain"] = max(_rounded(factor**2 * law.max_gain), law.start_gain)
    texts = {True: "true", None: "null"}
    settings = [
        f"{key}={texts.get(value, value) if isinstance(value, bool | None) else value}"
        for key, value in changes.items()
        if key != "delay" or part.get("delay") is not None
    ]
    return replace(law, **changes), settings


def _scaled_inertia(inertia: Any, scale: float) -> str:
    """Return the setting that multiplies M̂ by a number."""
    if isinstance(inertia, dict):
        return f"inertia.fraction={_rounded(scale * inertia['fraction'])}"
    values = scale * np.asarray(inertia, dtype=float)
    return f"inertia={np.vectorize(_rounded)(values).tolist()}".replace(" ", "")


def _rounded(value: float) -> float:
    """Return a number of three digits."""
    return float(f"{value:.3g}")


def _is_certified(
    scenario: Scenario, certified: CertifiedLaws, name: str, settings: list[str], *, is_searched: bool
) -> bool:
    """Return whether the certificate of the robot certifies a law with these settings; by a search, if wanted."""
    content = copy.deepcopy(scenario.model_dump())
    for setting in settings:
        apply_setting(content, setting)
    setup = certified.setup
    law = Scenario.parse(content).build_laws(setup.plant, setup.reference)[name]
    options = {
        "computation_delay": scenario.computation_delay,
        "samples": certified.samples,
        "points": certified[name].points,
    }
    robot = certify_robot(law, certified.plants, certified.workspace, **options, least_margin=0.0)
    if is_searched:
        robot = strengthen_robot(robot, law, certified.plants, certified.workspace, **options, orders=ORDERS[:-1])
    return robot.certified
