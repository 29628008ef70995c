"""The C of an FMU called from C: on another processor, and at random under the sanitizers."""

import re
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from export.test_firmware import require, run

pytest.importorskip("fmpy")
import tarc
from export.test_export_fmu import recorded, tdc
from tarc.export import export_fmu

DRIVER = Path(__file__).with_name("fmu_driver.c")


def built(folder, compiler):
    """Compile an FMU's sources with the driver; return the command that runs it, and the torques to expect."""
    data = recorded()
    data.inputs[:, 8:] = np.nan  # applied torques are not read
    written = export_fmu(tdc(), folder / "law.fmu", platforms=[])
    with zipfile.ZipFile(written.file) as archive:
        archive.extractall(folder)
    token = re.search('#define TOKEN "(.*)"', (folder / "sources" / "config.h").read_text())
    assert token is not None
    (folder / "inputs").write_bytes(data.inputs.tobytes())
    sources = [folder / "sources" / "law.c", folder / "sources" / "fmi2.c", DRIVER]
    options = ["-std=c99", "-ffp-contract=off", f"-I{folder / 'sources'}", *sources, "-lm", "-o", folder / "driver"]
    process = run([*compiler, *options])
    assert process.returncode == 0, process.stderr
    return [folder / "driver", token[1], folder / "inputs"]


@pytest.mark.slow
def test_sources_of_fmi_3_have_the_prefix_unless_it_is_overridden(tmp_path):
    require("gcc")
    export_fmu(tdc(), tmp_path / "law.fmu", fmi="3.0", platforms=[])
    with zipfile.ZipFile(tmp_path / "law.fmu") as archive:
        archive.extractall(tmp_path)
    program = tmp_path / "main.c"
    sources = [program, tmp_path / "sources" / "law.c", tmp_path / "sources" / "fmi3.c", "-lm"]
    for prefix, options in {"law_": [], "": ["-DFMI3_OVERRIDE_FUNCTION_PREFIX"]}.items():
        function = f"{prefix}fmi3GetVersion"
        program.write_text(f"const char *{function}(void);\nint main(void) {{ return {function}()[0] != '3'; }}\n")
        process = run(["gcc", "-std=c99", *options, *sources, "-o", tmp_path / "main"])
        assert process.returncode == 0, process.stderr
        assert run([tmp_path / "main"]).returncode == 0


def check(process):
    """Check that the torques have the bits of the law, and that none of the random calls exceeds its limit."""
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    *lines, largest = process.stdout.split("\n")[:-1]
    found = np.array([[int(word, 16) for word in line.split()] for line in lines], dtype=np.uint64).view(float)
    data = recorded()
    controller = tarc.Controller(tdc())
    controller.reset(data.inputs[0, :2])
    expected = [controller.step(*np.split(row[:8], 4)).copy() for row in data.inputs]
    np.testing.assert_array_equal(found, expected)
    assert 0 < float(largest) <= 5.0


@pytest.mark.slow
def test_random_calls_are_clean_under_the_sanitizers(tmp_path):
    require("gcc")
    options = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    check(run(built(tmp_path, ["gcc", *options, "-Wall", "-Wextra", "-Wconversion", "-Werror"])))


@pytest.mark.slow
def test_aarch64_gives_the_same_bits(tmp_path):
    require("qemu-aarch64")
    pytest.importorskip("ziglang")
    zig = [sys.executable, "-m", "ziglang", "cc", "-O2", "-target", "aarch64-linux-musl", "-static"]
    check(run(["qemu-aarch64", *built(tmp_path, zig)]))
