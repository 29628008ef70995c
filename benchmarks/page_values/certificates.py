"""Values of the pages on certificates and on the paper's claims."""

import sysconfig
from pathlib import Path

import numpy as np

import tarc
from benchmarks import tightness as shares
from benchmarks.page_values.explanation import grouped
from benchmarks.page_values.registry import NO_VALUE, Value, long_source, run_page, source, table
from tarc.analysis import Workspace, best_inertia_shape, stable_interval
from tarc.certificates import certify_sector, certify_varying_ratio

LOOPS = ((10, False), (5, False), (20, True), (10, True), (5, True))
RATES = (None, 100.0, 10.0, 1.0)
DIVERGED = {(False, 0.08): 1500, (True, 1.0): 2000, (True, 0.3): 1000}
"""Slopes [1/s²] whose switching diverges, as the tests of the sector certificate show."""


def _kind(synchronised: bool) -> str:
    return "synchronised" if synchronised else "literal"


@source
def certificates() -> dict[str, Value]:
    """Tables of the page on certificates, from its own code."""
    page = run_page("explanation/certificates.md")
    designed = page.names["designed"]
    balls = [
        (
            f"{_kind(synchronised == '1')}, N = {periods}",
            f"{float(centre):.3f}, {float(radius):.3f}",
            f"{float(ratio):.1f}",
        )
        for periods, synchronised, centre, radius, ratio in page.columns(r"^(\d+) ([01]) (\S+) (\S+) (\S+)$")
    ]
    stiffness = [float(value) for (value,) in page.columns(r" (\S+) 1/s²$")]
    return {
        "balls": table(["loop, 1 kHz, 10 rad/s", "centre, radius", "greatest ratio over least"], balls),
        "rates": _rates(designed),
        "shapes": _shapes({name: ratio for name, ratio in page.columns(r"^(ur5e|panda) (\S+)$")}),
        "slopes": _slopes(designed),
        "stiffness_at_rest": stiffness[0],
        "stiffness_in_motion": stiffness[1],
    }


def _rates(designed) -> str:
    rows = []
    for periods, synchronised in LOOPS:
        law = designed(periods, synchronised)
        ratios = [certify_varying_ratio(law, rate=rate).evidence.ratio_spread for rate in RATES]
        low, high = stable_interval(law)
        cells = [f"{ratio:.3g}" for ratio in (*ratios, high / low)]
        rows.append((f"{_kind(synchronised)}, N = {periods}", *cells))
    return table(["loop, 1 kHz, 10 rad/s", "any rate", "100 1/s", "10 1/s", "1 1/s", "constant"], rows)


def _shapes(shipped: dict[str, str]) -> str:
    data = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share")
    file = data / "example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
    plant = tarc.plants.load_robot(file, armature=0.1)
    _, ratio = best_inertia_shape(plant, Workspace.from_joint_limits(plant))
    rows = [
        ("UR5, from the URDF of `example-robot-data`", f"{ratio:.1f}"),
        ("UR5e", f"{float(shipped['ur5e']):.1f}"),
        ("Franka Panda", f"{float(shipped['panda']):.1f}"),
    ]
    return table(["robot", "ratio of the extreme eigenvalues"], rows)


def _slopes(designed) -> str:
    rows = []
    for (synchronised, ratio), diverged in DIVERGED.items():
        limits = certify_sector(designed(10, synchronised), ratio).evidence
        numbers = (grouped(round(limits.circle_limit)), grouped(round(limits.frozen_limit), 5), f"{diverged}")
        rows.append((f"{_kind(synchronised)}, ρ = {ratio:g}", *numbers))
    return table(["loop", "circle criterion", "frozen limit", "a switching slope that diverged"], rows)


THEOREM1_LABELS = (r"Theorem 1, longest $\omega_{n}$ h", "Theorem 1 without its $D^{-1}$ term")
"""Labels of the limits of Theorem 1, with its term in D and without."""


@long_source
def tightness() -> dict[str, Value]:
    """Shares of the exact limits that the certificates cover."""
    measured = shares.measure(show=False)
    balls = []
    for synchronised in (False, True):
        for window in shares.WINDOWS:
            pairs = [measured.balls[synchronised, window, frequency] for frequency in shares.BANDWIDTHS]
            balls.append((_kind(synchronised), f"{window}", *map(_share, pairs)))
    first, *others = (f"{frequency:g} rad/s" for frequency in shares.BANDWIDTHS)
    heads = ["loop", "window [periods]", f"natural frequency {first}", *others]
    limits = []
    for (degree, delay), share in measured.windows.items():
        label = "" if limits else r"repaired Theorem 2, longest $\omega_{n} \varsigma$"
        limits.append((label, f"{degree}", f"{delay:g}", *_limit(share, 3)))
    for label, share in zip(THEOREM1_LABELS, measured.delays.values(), strict=True):
        limits.append((label, "–", "–", *_limit(share, 4)))
    return {
        "balls": table(heads, balls),
        "nominal": table(["condition", "degree", r"$\omega_{n}$ h", "certified", "exact", "share"], limits),
    }


def _share(pair: shares.Balls | None) -> str:
    if pair is None:
        return "stable for none"
    ball, stable = pair.ball[1] / pair.ball[0], pair.stable[1] / pair.stable[0]
    return f"{100 * pair.share:.0f} % ({ball:.3g} of {stable:.3g})"


def _limit(share: shares.Share, digits: int) -> tuple[str, str, str]:
    return f"{share.certified:.{digits}f}", f"{share.exact:.{digits}f}", f"{100 * share.share:.0f} %"


@long_source
def soundness() -> dict[str, Value]:
    """Certificates of 10 000 random designs against simulation; takes hours."""
    from reference.soundness_checks import tally_certificates

    labels = {
        "constant_ratio": "constant ratio",
        "constant_ratio, a range": "constant ratio, a range",
        "varying_ratio": "varying ratio",
        "varying_ratio, slow": "slowly varying ratio",
        "sector": "sector",
    }
    tallies = tally_certificates(10_000, 0, None)
    rows = []
    for name, label in labels.items():
        tally = tallies[name]
        refuted = "–" if name.startswith("varying_ratio") else grouped(tally.refuted)
        counts = (grouped(tally.designs), grouped(tally.certified), refuted, grouped(tally.inconclusive))
        rows.append((label, *counts, f"{len(tally.violations)}"))
    return {
        "designs": table(["certificate", "designs", "certified", "refuted", "inconclusive", "wrong"], rows),
        "undecided": float(sum(tally.undecided for tally in tallies.values())),
    }


@source
def claims() -> dict[str, Value]:
    """Tables of the page on the paper's claims, from its own code."""
    page = run_page("explanation/claims.md")
    filters = [("window of 10 ms", *page.columns(r"^window (\S+) (\S+)$")[0])]
    filters += [
        (f"differences, {float(cutoff):g} rad/s", *rest) for cutoff, *rest in page.columns(r"^(\d+\.0) (\S+) (\S+)$")
    ]
    knowing = page.names["knowing"]["rms_error"]
    own, rivals = page.names["own"], page.names["rivals"]
    return {
        "derivatives": _derivatives(page.columns(r"^(TDC|TARC) +(None|16) +(\S+ mrad, \S+ N m/s)$")),
        "best": _best(page.columns(r"^(None|16) +(\S+) mrad, (\S+) M, (\S+)$")),
        "moves": _moves(own[4e3], rivals),
        "growth": _growth(page.names["grown"]),
        "stiff": _stiff(page.names["stiff"]),
        "later": _later(page.names["line"]),
        "filters": table(
            ["estimator", "RMS error [mrad]", "torque variation [N m/s]"],
            [(name, f"{1e3 * float(error):.2f}", f"{float(variation):.0f}") for name, error, variation in filters],
        ),
        "tarc_gain": own[4e3][16]["gain"],
        "tarc_gain_perfect": own[4e3][None]["gain"],
        "tarc_variation": own[4e3][16]["variation"],
        "asmc_variation": rivals[0.001][16]["variation"],
        "computed_torque": 1e3 * knowing,
        "tdc": 1e3 * page.names["plain"]["rms_error"],
    }


def _sensor(bits: str) -> str:
    return "perfect" if bits == "None" else f"{bits} bits"


def _derivatives(lines: list[tuple[str, ...]]) -> str:
    rows = [
        (law, _sensor(bits), window, truth)
        for (law, bits, window), (_, _, truth) in zip(lines[::2], lines[1::2], strict=True)
    ]
    return table(["law", "sensor", "window of 10 ms: error, torque variation", "true derivatives"], rows)


def _best(lines: list[tuple[str, ...]]) -> str:
    rows = []
    for place in range(0, len(lines), 3):
        bits = lines[place][0]
        windows = min(lines[place : place + 2], key=lambda line: float(line[1]))
        law = "TDC" if place < len(lines) / 2 else "TARC"
        rows.append((law, _sensor(bits), _choice(windows), _choice(lines[place + 2])))
    heads = ["law", "sensor", "window of 10 or 20 ms: error, M̂, ωn", "true derivatives: error, M̂, ωn"]
    return table(heads, rows)


def _choice(line: tuple[str, ...]) -> str:
    _, error, share, frequency = line
    inertia = "M" if float(share) == 1.0 else f"{100 * float(share):.0f} % of M"
    return f"{error} mrad, {inertia}, {frequency} rad/s"


def _moves(own: dict, rivals: dict) -> str:
    rows = [("TARC", *_counts(own))]
    rows += [(f"ASMC, δ = {threshold:g}", *_counts(rivals[threshold])) for threshold in (0.001, 0.003, 0.01, 0.03, 0.1)]
    return table(["law", "perfect sensor", "sample", "20 ms", "16 bits", "sample", "20 ms"], rows)


def _growth(grown: dict) -> str:
    rows = []
    for name, pair in grown.items():
        for bits, run in pair.items():
            moves = f"{run['smooth overestimation']:.1f}, {run['smooth underestimation']:.1f}"
            rows.append((name, _sensor(str(bits)), f"{run['gain']:.2f}", f"{run['error']:.2f}", moves))
    heads = ["f", "sensor", "mean gain [rad/s²]", "RMS error [mrad]", "over- and underestimation over 20 ms [%]"]
    return table(heads, rows)


def _stiff(found: dict[tuple[str, float], dict[str, float]]) -> str:
    names = list(dict.fromkeys(name for name, _ in found))
    gains = list(dict.fromkeys(gain for _, gain in found))
    rows = []
    for name in names:
        cells = [_stiff_cell(found[name, gain], name) for gain in gains]
        rows.append((name, *cells))
    heads = ["f", *(f"mean gain {gain:g} rad/s²: mrad, N m/s, over- and underestimation" for gain in gains)]
    return table(heads, rows)


def _stiff_cell(one: dict[str, float], name: str) -> str:
    moves = "" if name == "constant gain" else f", {one['over']:.0f} and {one['under']:.0f} %"
    return f"{one['error']:.3f}, {one['variation']:.0f}{moves}"


def _later(line: dict[str, dict[str, float]]) -> str:
    rows = []
    for name, run in line.items():
        moves = f"{100 * run['overestimation']:.1f}, {100 * run['underestimation']:.1f}" if "mean_gain" in run else ""
        adapts = moves and not name.startswith("barrier")
        error, peak = f"{1e3 * run['rms_error']:.3f}", f"{run['peak']:.2f}"
        numbers = (error, peak, f"{run['outside']:.1f} %", f"{run['torque_variation']:.0f}")
        rows.append((name, *numbers, moves if adapts else NO_VALUE))
    heads = ["law", "RMS error [mrad]", "peak of a joint [mrad]", "beyond 3 mrad", "torque variation [N m/s]"]
    return table([*heads, "over- and underestimation over 20 ms [%]"], rows)


def _counts(runs: dict) -> list[str]:
    cells = []
    for bits in (None, 16):
        run = {name: float(np.round(value, 3)) for name, value in runs[bits].items()}
        cells.append(f"{run['error']:.2f}")
        cells.append(f"{run['overestimation']:.1f}, {run['underestimation']:.1f}")
        cells.append(f"{run['smooth overestimation']:.1f}, {run['smooth underestimation']:.1f}")
    return cells
