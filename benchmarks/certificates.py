"""Certificates: one joint, thirty joints, and everything there is for a robot."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import tarc
from benchmarks.measure import Row, best
from tarc.certificates import certify_affine, certify_constant_ratio, certify_varying_ratio
from tarc.paper import check_theorem1

LIMITS = {
    "constant_ratio": 5e-3,
    "constant_ratio, of a law that was traced before": 5e-3,
    "varying_ratio": 0.1,
    "theorem1": 1.0,
}


def law(joints: int) -> tarc.laws.TDC:
    """TDC at 1 kHz with a window of ten periods, made anew, so that nothing about it is known yet."""
    estimator = tarc.estimators.Algebraic(window=0.010, degree=2)
    inertia = 0.1 * (np.eye(joints) + 0.2 * np.ones((joints, joints)))
    return tarc.laws.TDC(inertia=inertia, natural_frequency=10.0, period=1e-3, estimator=estimator)


def one_and_thirty() -> list[Row]:
    """Measure constant ratio, varying ratio and the paper's first theorem, from making the law on."""
    known = {joints: law(joints) for joints in (1, 30)}
    calls: dict[str, Any] = {
        "constant_ratio": lambda joints: certify_constant_ratio(law(joints), 0.08),
        "constant_ratio, of a law that was traced before": lambda joints: certify_constant_ratio(known[joints], 0.08),
        "varying_ratio": lambda joints: certify_varying_ratio(law(joints)),
        "theorem1": lambda joints: check_theorem1(law(joints)),
    }
    rows = []
    for name, call in calls.items():
        call(1)
        one, many = best([lambda call=call: call(1), lambda call=call: call(30)], 1, 9)
        limit = LIMITS[name]
        target = f"≤ {1e3 * limit:g} ms; 30 joints as 1"
        what = f"certificates.{name}, 1 joint"
        rows.append(
            Row(what, f"{1e3 * one:.1f} ms", f"30 joints: {1e3 * many:.1f} ms", many / one, target, one <= limit)
        )
    return rows


AFFINE_CASES = ((5, (0.03, 2.5), 5.0), (10, (0.05, 2.5), 30.0), (29, (0.2, 2.2), 120.0))
"""Windows of synchronised laws [periods], ranges of ratios, and limits on the time [s]."""


def affine() -> list[Row]:
    """Search and proof of a Lyapunov function affine in the inertia, by the number of states 2N + 2."""
    rows = []
    for window, ratio_range, limit in AFFINE_CASES:
        estimator = tarc.estimators.Algebraic(window=window * 1e-3, degree=2)
        designed = tarc.laws.TDC(
            inertia=0.1, natural_frequency=10.0, period=1e-3, estimator=estimator, synchronised=True
        )
        begin = time.perf_counter()
        certificate = certify_affine(designed, ratio_range, 10.0)
        found = time.perf_counter()
        proven = certificate.verify() and certificate.certified
        proof = time.perf_counter() - found
        search = found - begin - proof
        what = f"certificates.affine, {2 * window + 2} states, search"
        met = proven and search + proof <= limit
        rows.append(Row(what, f"{search:.1f} s", f"proof: {1e3 * proof:.0f} ms", None, f"≤ {limit:g} s", met))
    return rows


def command() -> list[Row]:
    """`tarc certify ur5e` as a user types it, two laws, with and without its figures."""
    tool = Path(sys.executable).parent / "tarc"
    times = []
    for options in (["--no-figures"], []):
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            subprocess.run(
                [tool, "certify", "ur5e", "--quick", *options, "-o", folder], check=True, capture_output=True
            )
            times.append(time.perf_counter() - begin)
    plain, drawn = times
    what = "tarc certify ur5e --quick, two laws, without figures"
    return [Row(what, f"{plain:.1f} s", f"with figures: {drawn:.1f} s", None, "≤ 5 s", plain <= 5)]
