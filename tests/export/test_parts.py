"""Parts of a law in C: estimator, M̂(q) and reference give the bits of Python, and are what the law has."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import tarc
from law_catalogue import ESTIMATORS, make_law
from tarc.core.codegen import compiler
from tarc.core.errors import UnsupportedLaw
from tarc.export import export_c, verify_export
from tarc.export.c_source import CSource, calls_library
from tarc.export.parts import Parts, piecewise
from tarc.export.traced_law import traced_law

POINTS = np.array([[0.0, 1.0], [0.5, -0.4], [0.2, 0.3], [1.0, 0.0]])
TIMES = [0.5, 1.0, 2.5, 3.0]


def references(folder):
    record = np.column_stack([np.linspace(0, 2, 41), np.sin(np.linspace(0, 2, 41)), np.cos(np.linspace(0, 4, 41))])
    np.save(folder / "record.npy", record)
    (folder / "points.csv").write_text("time,a,b,a/velocity,b/velocity\n0,0,1,0,0\n1,0.5,0.2,0.1,0.2\n2,1,0,0,0\n")
    return {
        "sinusoid": tarc.signals.Sinusoid(amplitude=[0.5, 0.2], frequency=[3.0, 2.0], phase=0.3, offset=[0.0, 1.0]),
        "multisine": tarc.signals.Multisine(amplitude=[0.2, 0.1], frequency=[1.0, 2.5, 4.0], offset=[0.1, 0.2]),
        "chirp": tarc.signals.Chirp(amplitude=[0.2, 0.1], start_frequency=1.0, stop_frequency=5.0, sweep_time=4.0),
        "spline": tarc.signals.Quintic(points=POINTS, times=TIMES),
        "stops": tarc.signals.Quintic(points=POINTS, times=TIMES, stop_at_points=True),
        "record": tarc.signals.RecordedReference(path=folder / "record.npy"),
        "smooth record": tarc.signals.RecordedReference(path=folder / "record.npy", cutoff=2.0),
        "trajectory": tarc.signals.JointTrajectory(path=folder / "points.csv"),
    }


def parts_of(law, reference=None, single=False):
    return Parts(CSource(traced_law(law), "law", single, "law"), reference)


def with_model():
    law = make_law(tarc.laws.TDC)
    return replace(law, inertia=tarc.NominalInertia(tarc.plants.TwoLinkArm(), 0.2, gravity=True))


@pytest.mark.slow
@pytest.mark.parametrize("real", ["double", "float"])
def test_parts_give_the_bits_of_python(real, tmp_path):
    reference = tarc.signals.Quintic(points=POINTS, times=TIMES)
    law = make_law(tarc.laws.TARC)
    export_c(law, tmp_path, name="law", real=real, parts=True, reference=reference)
    report = verify_export(tmp_path, law=law, steps=100)
    assert report.passed
    assert report.parts is not None
    assert report.parts.startswith("estimator and reference: 0 of 1320 numbers differ")
    text = (tmp_path / "src" / "law_parts.c").read_text()
    (tmp_path / "src" / "law_parts.c").write_text(text.replace("* u) +", "* u) -", 1))
    changed = verify_export(tmp_path, steps=100)
    assert not changed.parts_passed
    assert not changed.is_unchanged
    assert not changed.passed


@pytest.mark.slow
@pytest.mark.parametrize("single", [False, True])
def test_every_estimator_is_a_part(single, tmp_path):
    for name in ESTIMATORS:
        if name == "truth":
            continue
        law = make_law(tarc.laws.TDC, 2, name)
        parts = parts_of(law, single=single)
        printed = run_parts(parts, tmp_path / name)
        if single and calls_library(parts.code, single):  # NumPy's powf is not that of the C library
            assert name in ("implicit", "explicit")
        else:
            assert printed == "estimator: 0 of 960 numbers differ", name


def test_inertia_and_formulas_are_parts(tmp_path):
    law = with_model()
    for name, reference in references(tmp_path).items():
        if name not in ("chirp", "stops"):
            continue
        parts = parts_of(law, reference)
        assert parts.names == ["estimator", "inertia", "reference"]
        assert " 0 of 1400 numbers differ" in run_parts(parts, tmp_path / name)
        positions, inertias = parts.recorded["inertia"]
        for position, inertia in zip(positions[:5], inertias, strict=False):
            expected = 0.2 * tarc.plants.TwoLinkArm().inertia(position)
            np.testing.assert_allclose(inertia.reshape(2, 2), expected, rtol=1e-13)


def test_references_are_those_of_sample(tmp_path):
    for reference in references(tmp_path).values():
        times, rows = parts_of(make_law(tarc.laws.TDC), reference).recorded["reference"]
        expected = np.concatenate(reference.sample(times[:-1, 0])).T
        np.testing.assert_allclose(rows[:-1], expected, rtol=1e-9, atol=1e-9)
        assert np.all(np.isnan(rows[-1]))
        inside = [reference.at(float(time)) for time in times[:-1, 0]]
        np.testing.assert_allclose(np.reshape(inside, (len(inside), -1)), expected, rtol=1e-12, atol=1e-12)


def test_pieces_are_held_outside_and_meet_at_their_ends():
    reference = tarc.signals.Quintic(points=POINTS, times=TIMES)
    pieces = reference.pieces()
    for time, point in zip([0.0, *TIMES, 9.0], [POINTS[0], *POINTS, POINTS[-1]], strict=True):
        np.testing.assert_allclose(piecewise(pieces, time)[:2], point, atol=1e-12)
    assert np.all(piecewise(pieces, 9.0)[2:] == 0)


def test_the_estimator_alone_is_that_of_the_law():
    law = make_law(tarc.laws.TARC)
    positions, outputs = parts_of(law).recorded["estimator"]
    estimator = law.estimator
    state = estimator.init(positions[0])
    for row, expected in zip(positions, outputs, strict=True):
        state, estimate = estimator.step(state, row)
        np.testing.assert_allclose(np.concatenate(estimate), expected, rtol=1e-9, atol=1e-6)


def test_a_reference_without_c_is_refused(tmp_path):
    class Own(tarc.signals.Sinusoid):
        def at(self, time):
            return super(tarc.signals.Sinusoid, self).at(time)

    own = Own(amplitude=[0.5, 0.2], frequency=1.0)
    with pytest.raises(UnsupportedLaw, match="reference: Own is no formula"):
        export_c(make_law(tarc.laws.TDC), tmp_path / "one", name="law", parts=True, reference=own)
    table = np.column_stack([np.arange(9000.0), np.sin(np.arange(9000.0)), np.cos(np.arange(9000.0))])
    np.save(tmp_path / "long.npy", table)
    long = tarc.signals.RecordedReference(path=tmp_path / "long.npy")
    with pytest.raises(UnsupportedLaw, match="its table has 107988 numbers"):
        export_c(make_law(tarc.laws.TDC), tmp_path / "two", name="law", parts=True, reference=long)


def run_parts(parts, folder):
    """Compile and run the test of parts with the warnings on; return what it printed, up to the semicolon."""
    for path, text in (parts.texts() | {"src/law.h": parts.source.header}).items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    flags = ["-std=c99", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow"]
    files = [f"-I{folder / 'src'}", f"-I{folder / 'test'}", folder / "src" / "law_parts.c", folder / "test" / "parts.c"]
    command = [*compiler(), *flags, "-Werror", *files, "-o", folder / "run", "-lm"]
    subprocess.run([str(word) for word in command], check=True)
    process = subprocess.run([str(folder / "run")], capture_output=True, text=True, check=False)
    shutil.rmtree(folder)
    assert process.returncode == 0
    return process.stdout.partition(";")[0]
