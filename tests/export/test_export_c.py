"""Exported C is the law: the same bits, no warnings, and nothing of anybody else's is touched."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import tarc
from law_catalogue import concrete_laws, make_law
from tarc.core.codegen import compiler
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.export import export_c, vectors, verify_export
from tarc.export.c_project import c_name
from tarc.export.c_source import CSource
from tarc.export.traced_law import traced_law
from tarc.signals import TorqueLimits

QUICK = ("TARC",)


def tdc(**options):
    return tarc.laws.TDC(
        inertia=[0.1, 0.2],
        natural_frequency=10.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
        **options,
    )


def compared(report):
    assert report.comparison is not None
    return report.comparison


def with_model(**options):
    arm = tarc.plants.TwoLinkArm()
    gravity = "feedforward" not in options
    return replace(tdc(), inertia=tarc.NominalInertia(arm, 0.2, gravity=gravity), **options)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind.__name__ in QUICK else pytest.mark.slow, id=kind.__name__)
        for kind in concrete_laws()
    ],
)
@pytest.mark.parametrize("real", ["double", "float"])
def test_every_law_gives_the_same_bits_without_warnings(kind, real, tmp_path):
    law = make_law(kind)
    export_c(law, tmp_path / "out", name="law", real=real)
    report = verify_export(tmp_path / "out", law=law, steps=1000)
    assert report.is_unchanged
    assert report.is_same_law
    assert [replay.warnings for replay in report.replays] == ["", ""]
    exact = not CSource(traced_law(law), "law", real == "float", "").uses_library
    if exact or real == "double":  # the same C library
        assert [replay.different for replay in report.replays] == [0, 0]
        assert compared(report).different == 0
    assert report.passed


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"synchronised": True},
        {"feedforward": tarc.Feedforward(tarc.plants.TwoLinkArm())},
    ],
)
def test_a_law_with_a_model_starts_and_runs_as_in_python(options, tmp_path):
    law = with_model(**options)
    export_c(law, tmp_path, name="law")
    report = verify_export(tmp_path, law=law, steps=1000)
    assert report.passed
    assert compared(report).different == 0


def test_recorded_steps_are_those_of_the_controller():
    law = replace(tdc(), torque_limit=[3.0, 5.0])
    limits = TorqueLimits(rate=2000.0)
    source = CSource(traced_law(law, limits), "law", False, "")
    position, torque, inputs = vectors.random_inputs(2, 60, 3)
    recorded = vectors.record(source, position, torque, inputs)
    controller = tarc.Controller(law, torque_limits=limits)
    controller.reset(position, torque)
    for row, expected in zip(inputs, recorded.outputs, strict=True):
        found = controller.step(row[:2], row[2:4], row[4:6], row[6:8], applied_torque=row[8:])
        np.testing.assert_array_equal(found, expected[:2])
        assert controller.missing == expected[source.signals[0].start]


def test_single_precision_decides_alike_and_stays_near(tmp_path):
    law = tdc()
    export_c(law, tmp_path, name="law", real="float")
    report = verify_export(tmp_path, law=law, steps=500)
    found = compared(report)
    assert found.different == 0
    assert found.decisions == 0
    assert 0 < found.torque_difference < 0.1


def test_the_same_law_gives_the_same_bytes(tmp_path):
    first, second = (export_c(tdc(), tmp_path / name, name="law") for name in ("one", "two"))
    assert first.digest == second.digest
    for one, two in zip(first.files, second.files, strict=True):
        assert one.read_bytes() == two.read_bytes()


def test_changed_c_is_found(tmp_path):
    law = tdc()
    export_c(law, tmp_path, name="law")
    file = tmp_path / "src" / "law.c"
    text = file.read_text()
    assert "0.1;" in text
    file.write_text(text.replace("0.1;", "0.11;", 1))
    report = verify_export(tmp_path, law=law, steps=200)
    assert not report.is_unchanged
    assert report.is_same_law is False
    assert not report.passed


def test_files_of_others_stay(tmp_path):
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "law.c").write_text("mine")
    (tmp_path / "notes.txt").write_text("mine too")
    with pytest.raises(InvalidParameter, match=r"law\.c, which this command did not write"):
        export_c(tdc(), tmp_path, name="law")
    assert not (tmp_path / "README.md").exists()
    (tmp_path / "src" / "law.c").unlink()
    export_c(tdc(), tmp_path, name="law")
    export_c(replace(tdc(), natural_frequency=12.0), tmp_path, name="law")  # its own files it may replace
    assert (tmp_path / "notes.txt").read_text() == "mine too"
    (tmp_path / "src" / "law.h").write_text("changed by hand")
    with pytest.raises(InvalidParameter, match=r"law\.h"):
        export_c(tdc(), tmp_path, name="law")


def test_names_are_those_of_c():
    assert c_name("Left Arm-2", given=False) == "left_arm_2"
    assert c_name("7axis", given=False) == "law_7axis"
    for bad in ("Arm", "1arm", "double", "a b", ""):
        with pytest.raises(InvalidParameter, match="names C"):
            c_name(bad)


def test_a_law_that_calls_a_library_is_refused(tmp_path):
    arm = tarc.plants.load_robot("ur5e", armature=0.1, backend="mujoco")
    law = tarc.laws.ComputedTorque(
        model=arm,
        natural_frequency=10.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
    )
    with pytest.raises(UnsupportedLaw):
        export_c(law, tmp_path, name="law")


def test_fast_mathematics_is_refused(tmp_path):
    export_c(tdc(), tmp_path, name="law")
    command = [*compiler(), "-std=c99", "-ffast-math", "-c", str(tmp_path / "src" / "law.c"), "-o", "/dev/null"]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode != 0
    assert "NAN" in process.stderr


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind.__name__ in QUICK else pytest.mark.slow, id=kind.__name__)
        for kind in concrete_laws()
    ],
)
@pytest.mark.parametrize("real", ["double", "float"])
def test_absurd_inputs_give_no_absurd_torque(kind, real, tmp_path):
    law = replace(make_law(kind), torque_limit=[3.0, 5.0])
    export_c(law, tmp_path, name="law", real=real, watch=watch_of_everything())
    files = [f"-I{tmp_path / 'src'}", tmp_path / "src" / "law.c", tmp_path / "test" / "fuzz.c", "-lm"]
    flags = ["-std=c99", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
    command = [*compiler(), *flags, *files, "-o", tmp_path / "fuzz"]
    subprocess.run([str(word) for word in command], check=True)
    process = subprocess.run([str(tmp_path / "fuzz"), "60000", "3"], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout
    assert process.stdout.startswith("60000 absurd steps: 0 torques not finite, 0 beyond their limit")
    good, missing, fault = (
        int(word) for word in re.findall(r"(\d+) (?:steps good|with missing|in a fault)", process.stdout)
    )
    assert min(good, missing, fault) > 6000


def test_a_torque_for_a_drive_is_rounded_limited_and_never_made_up(tmp_path):
    export_c(tdc(), tmp_path, name="law")
    cases = {
        "1.0, 2.0": 500,
        "-1.0, 2.0": -500,
        "0.0005, 1.0": 1,
        "0.00049, 1.0": 0,
        "1e6, 1.0": 32767,
        "-1e6, 1.0": -32768,
        "32.7674, 1.0": 32767,
        "NAN, 1.0": 0,
        "INFINITY, 1.0": 0,
        "1.0, 0.0": 0,
        "1.0, -1.0": 0,
        "1.0, NAN": 0,
        "1e300, 1e-300": 0,
    }
    checks = "\n".join(f"  wrong += law_cia402_torque({given}) != {value};" for given, value in cases.items())
    program = tmp_path / "test" / "drive.c"
    program.write_text(
        f'#include "law.h"\n#include <math.h>\nint main(void)\n{{\n  int wrong = 0;\n{checks}\n  return wrong;\n}}\n'
    )
    files = [f"-I{tmp_path / 'src'}", tmp_path / "src" / "law.c", program, "-lm", "-o", tmp_path / "drive"]
    subprocess.run([str(word) for word in [*compiler(), "-std=c99", "-ffp-contract=off", *files]], check=True)
    assert subprocess.run([str(tmp_path / "drive")], check=False).returncode == 0


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")
def test_a_cpp_compiler_takes_header_and_source(tmp_path):
    export_c(tdc(), tmp_path, name="law")
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror", "-x", "c++"]
    command = ["g++", *flags, "-c", str(tmp_path / "src" / "law.c"), "-o", str(tmp_path / "law.o")]
    subprocess.run(command, check=True)


def watch_of_everything():
    return tarc.Watch(
        n_joints=2,
        low=[-0.9, -np.inf],
        high=0.2,
        tube=0.05,
        speed=[0.5, 1.0],
        rest_torque=[1.0, 2.0],
        rest_speed=5.0,
        rest_periods=7,
        period=1e-3,
        tolerance=0.05,
    )


@pytest.mark.parametrize("real", ["double", pytest.param("float", marks=pytest.mark.slow)])
def test_watched_assumptions_give_the_same_flags(real, tmp_path):
    law, watch = tdc(torque_limit=[3.0, 5.0]), watch_of_everything()
    written = export_c(law, tmp_path, name="law", real=real, watch=watch)
    report = verify_export(tmp_path, law=law, steps=2000)
    assert report.passed
    assert compared(report).different == 0
    header = (tmp_path / "src" / "law.h").read_text()
    assert "#define LAW_FLAG_LOAD 8u" in header
    assert header.index("elapsed; /*") < header.index("} law_input;")
    assert header.index("velocity_estimate[2];") < header.index("unsigned flags;") < header.index("} law_output;")
    assert "LAW_FLAG_TIMING" in (written.folder / "README.md").read_text()


def test_flags_in_c_are_those_of_the_watcher():
    law, watch = tdc(torque_limit=[3.0, 5.0]), watch_of_everything()
    source = CSource(traced_law(law, None, watch), "law", False, "")
    recorded = vectors.record(source, *vectors.inputs_of(source, 400, 6))
    watcher = tarc.Watcher(watch)
    assert source.signals[2].name == "velocity_estimate"
    velocity = source.signals[2].start
    for row, outputs in zip(recorded.inputs, recorded.outputs, strict=True):
        flags = watcher.step(row[:2], row[2:4], outputs[velocity : velocity + 2], outputs[:2], elapsed=row[10])
        assert (flags, watcher.flags_seen) == (outputs[-2], outputs[-1])
    assert watcher.flags_seen == watch.watched


def test_the_command_watches_what_certify_assumes(tmp_path):
    from typer.testing import CliRunner

    from tarc.cli.main import app
    from tarc.export.verification import read_law_yaml

    command = [
        "export",
        "c",
        "train_two_link",
        "--law",
        "TDC",
        "--watch",
        "--tube",
        "0.02",
        "-o",
        str(tmp_path / "arm"),
    ]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    watch = tarc.Scenario.load("train_two_link").watch("TDC", tube=0.02)
    written = read_law_yaml(tmp_path / "arm")["watch"]
    assert written["tube"] == np.asarray(watch.tube).tolist() == [0.02] * watch.n_joints
    assert written["speed"] == np.asarray(watch.speed).tolist()
    report = verify_export(tmp_path / "arm", steps=100)
    assert report.passed


def test_without_a_watch_nothing_of_it_is_there(tmp_path):
    export_c(tdc(), tmp_path, name="law")
    for file in ("src/law.h", "src/law.c", "README.md", "law.yaml", "test/replay.h"):
        text = (tmp_path / file).read_text()
        assert "flags" not in text
        assert "elapsed" not in text


def test_set_points_of_inner_loops_say_so_and_never_jump_to_zero(tmp_path):
    plant = tarc.plants.PositionServo(tarc.plants.TwoLinkArm(), kp=500.0, kd=20.0)
    law = replace(tdc(), torque_limit=plant.torque_limits)
    with pytest.raises(InvalidParameter, match="jump to the position zero; use safe_torque='hold'"):
        export_c(law, tmp_path, name="law", commands=plant.torque_units)
    law = replace(law, safe_torque="hold")
    with pytest.raises(InvalidParameter, match="got 3 units"):
        export_c(law, tmp_path, name="law", commands=["rad"] * 3)
    export_c(law, tmp_path, name="law", commands=plant.torque_units)
    assert " * in rad, rad." in (tmp_path / "src" / "law.h").read_text()
    report = verify_export(tmp_path, law=law, steps=200)
    assert report.passed
    assert report.is_same_law
    program = tmp_path / "test" / "null.c"
    program.write_text(
        '#include "law.h"\n#include <stddef.h>\nint main(void)\n{\n  law_t law = {{{0}}, 0, 0};\n'
        "  const double q[2] = {0.5, 1.0};\n"
        "  return law_reset(&law, q, NULL) != LAW_BAD_INPUT || law_reset(&law, q, q) != LAW_OK;\n}\n"
    )
    files = [f"-I{tmp_path / 'src'}", tmp_path / "src" / "law.c", program, "-lm", "-o", tmp_path / "null"]
    subprocess.run([str(word) for word in [*compiler(), "-std=c99", "-ffp-contract=off", *files]], check=True)
    assert subprocess.run([str(tmp_path / "null")], check=False).returncode == 0
    export_c(replace(law, safe_torque="zero"), tmp_path / "torque", name="law", commands=["N m", "N"])
    assert "torques in N m or N" in (tmp_path / "torque" / "src" / "law.h").read_text()


def test_a_watch_of_another_robot_is_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="got one of 3 joints; needs one of the law's 2"):
        export_c(tdc(), tmp_path, watch=tarc.Watch(n_joints=3, speed=1.0))
