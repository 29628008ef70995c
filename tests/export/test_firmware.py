"""Exported C on other processors, emulated, and under the sanitizers: the same bits."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tarc
from law_catalogue import concrete_laws, make_law
from tarc.export import export_c, vectors
from tarc.export.c_source import CSource
from tarc.export.traced_law import traced_law

STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror"]
BUILD = ["-std=c99", "-O2", "-ffp-contract=off"]


def require(*tools):
    """Skip without the tools; fail where TARC_REQUIRE_CROSS says that they must be there, as in .ci/run."""
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if not missing:
        return
    packages = "gcc-arm-none-eabi, qemu-system-arm, qemu-user, clang and cppcheck"
    message = f"there is no {', '.join(missing)}; of Debian install {packages}"
    if os.environ.get("TARC_REQUIRE_CROSS"):
        pytest.fail(f"{message}: TARC_REQUIRE_CROSS is set")
    pytest.skip(message)


def run(command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)


def run_firmware(folder, *options):
    require("arm-none-eabi-gcc", "qemu-system-arm", "make", "awk")
    return run(["make", "-s", "-C", folder / "firmware", "run", *options])


def replay_files(folder):
    return [
        f"-I{folder / 'src'}",
        f"-I{folder / 'test'}",
        folder / "src" / "law.c",
        folder / "test" / "replay.c",
        "-lm",
    ]


def law_and_firmware(kind, folder, real):
    law = make_law(kind)
    export_c(law, folder, name="law", real=real, firmware=True)
    return CSource(traced_law(law), "law", real == "float", "")


def test_firmware_comes_on_request_and_is_deterministic(tmp_path):
    law = make_law(tarc.laws.TDC)
    export_c(law, tmp_path / "plain", name="law")
    assert not (tmp_path / "plain" / "firmware").exists()
    one, two = (export_c(law, tmp_path / name, name="law", firmware=True) for name in ("one", "two"))
    files = {file.name for file in one.files if file.parent.name == "firmware"}
    assert files == {"Makefile", "main.c", "mps2.ld", "semihosting.h", "start.c"}
    for first, second in zip(one.files, two.files, strict=True):
        assert first.read_bytes() == second.read_bytes()


def test_the_replay_is_clean_under_the_sanitizers(tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("there is no gcc")
    export_c(make_law(tarc.laws.TARC), tmp_path, name="law")
    sanitizers = ["-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    empty = tmp_path / "empty.c"
    empty.write_text("int main(void) { return 0; }\n")
    if run(["gcc", *sanitizers, empty, "-o", tmp_path / "empty"]).returncode:
        pytest.skip("this gcc has no sanitizers")
    built = run(["gcc", *BUILD, *STRICT, *sanitizers, *replay_files(tmp_path), "-o", tmp_path / "replay"])
    assert built.returncode == 0, built.stderr
    replayed = run([tmp_path / "replay", 500])
    assert replayed.returncode == 0, replayed.stderr
    assert replayed.stderr == ""
    assert "200 steps, 0 of " in replayed.stdout


@pytest.mark.slow
@pytest.mark.parametrize(("real", "core"), [("float", "cortex-m4"), ("double", "cortex-m7")])
@pytest.mark.parametrize("kind", [pytest.param(kind, id=kind.__name__) for kind in concrete_laws()])
def test_every_law_runs_on_a_microcontroller(kind, real, core, tmp_path):
    source = law_and_firmware(kind, tmp_path, real)
    process = run_firmware(tmp_path, f"CORES={core}")
    assert process.returncode == 0, process.stdout + process.stderr
    assert process.stderr == ""
    assert f"{core}, {real}: 200 steps" in process.stdout
    assert "; 0 by more than" in process.stdout
    if not source.uses_library:
        assert "200 steps, 0 of " in process.stdout


@pytest.mark.slow
def test_all_cores_give_the_same_bits_and_the_fpu_saves_instructions(tmp_path):
    law_and_firmware(tarc.laws.TARC, tmp_path, "float")
    process = run_firmware(tmp_path, "OPT=-O3")
    assert process.returncode == 0, process.stdout + process.stderr
    lines = process.stdout.splitlines()
    assert [line.split(",")[0] for line in lines[::3]] == ["cortex-m3", "cortex-m4", "cortex-m7"]
    assert all("200 steps, 0 of " in line for line in lines[::3])
    soft, single, double = (int(line.split()[0]) for line in lines[1::3])
    assert soft > 4 * single
    assert abs(single - double) < 0.1 * single


@pytest.mark.slow
def test_a_build_without_the_option_gives_the_same_bits(tmp_path):
    law_and_firmware(tarc.laws.TARC, tmp_path, "float")
    makefile = tmp_path / "firmware" / "Makefile"
    text = makefile.read_text()
    assert "-std=c99 $(OPT) -ffp-contract=off" in text
    makefile.write_text(text.replace("-std=c99 $(OPT) -ffp-contract=off", "-std=gnu99 $(OPT)"))
    process = run_firmware(tmp_path, "CORES=cortex-m4")
    assert process.returncode == 0, process.stdout + process.stderr
    assert "200 steps, 0 of " in process.stdout


@pytest.mark.slow
def test_a_wrong_number_fails_on_the_microcontroller(tmp_path):
    law_and_firmware(tarc.laws.TDC, tmp_path, "float")
    file = tmp_path / "src" / "law.c"
    text = file.read_text()
    assert " - " in text
    head, _, tail = text.rpartition(" - a")
    file.write_text(f"{head} + a{tail}")
    process = run_firmware(tmp_path, "CORES=cortex-m4")
    assert process.returncode != 0
    assert "200 steps, 0 of " not in process.stdout


@pytest.mark.slow
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("kind", [tarc.laws.TARC, tarc.laws.SuperTwisting], ids=lambda kind: kind.__name__)
def test_aarch64_gives_the_same_bits(kind, real, tmp_path):
    require("qemu-aarch64")
    pytest.importorskip("ziglang")
    export_c(make_law(kind), tmp_path, name="law", real=real)
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", "aarch64-linux-musl", "-static"]
    built = run([*zig, *BUILD, *STRICT, *replay_files(tmp_path), "-o", tmp_path / "replay"])
    assert built.returncode == 0, built.stderr
    replayed = run(["qemu-aarch64", tmp_path / "replay"])
    assert replayed.returncode == 0, replayed.stdout
    assert "200 steps, 0 of " in replayed.stdout


@pytest.mark.slow
@pytest.mark.parametrize("real", ["float", "double"])
def test_clang_has_no_warning_and_gives_the_same_bits(real, tmp_path):
    require("clang")
    law = make_law(tarc.laws.TARC)
    watch = tarc.Watch(n_joints=2, low=-1.0, speed=2.0, period=law.period)
    export_c(law, tmp_path, name="law", real=real, watch=watch, parts=True)
    sources = [tmp_path / "src" / "law.c", tmp_path / "src" / "law_parts.c"]
    for language in (["-std=c99"], ["-x", "c++", "-std=c++17"]):
        for source in sources:
            flags = [*language, "-O2", "-ffp-contract=off", *STRICT, "-Wmissing-prototypes", f"-I{tmp_path / 'src'}"]
            built = run(["clang", *flags, "-c", source, "-o", tmp_path / "law.o"])
            assert built.returncode == 0, built.stderr
    built = run(["clang", *BUILD, *STRICT, *replay_files(tmp_path), "-o", tmp_path / "replay"])
    assert built.returncode == 0, built.stderr
    assert "200 steps, 0 of " in run([tmp_path / "replay"]).stdout


@pytest.mark.slow
def test_misra_finds_what_the_reference_lists(tmp_path):
    require("cppcheck")
    export_c(make_law(tarc.laws.TARC), tmp_path, name="law", parts=True)
    command = ["cppcheck", "--std=c99", "--addon=misra", "--suppress=missingIncludeSystem", "--template={id}"]
    checked = run([*command, f"-I{tmp_path / 'src'}", tmp_path / "src"])
    assert checked.returncode == 0, checked.stderr
    found = {line for line in checked.stderr.splitlines() if line.startswith("misra") or "error" in line.lower()}
    page = (Path(__file__).parents[2] / "docs" / "reference" / "export.md").read_text(encoding="utf-8")
    listed = {f"misra-c2012-{rule}" for rule in re.findall(r"^\| ([\d.]+),", page, re.MULTILINE)}
    assert found
    assert found <= listed


@pytest.mark.slow
@pytest.mark.parametrize("kind", [tarc.laws.AdaptiveFuzzy, tarc.laws.TerminalSliding], ids=lambda kind: kind.__name__)
def test_another_c_library_rounds_and_decides_nothing_else(kind, tmp_path):
    pytest.importorskip("ziglang")
    law = make_law(kind)
    source = CSource(traced_law(law), "law", False, "")
    assert source.uses_library
    export_c(law, tmp_path, name="law")
    recorded = vectors.record(source, *vectors.inputs_of(source, 2000, 1))
    (tmp_path / "test" / "vectors.h").write_text(vectors.header(source, recorded))
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-linux-musl", "-static"]
    built = run([*zig, *BUILD, *STRICT, *replay_files(tmp_path), "-o", tmp_path / "replay"])
    assert built.returncode == 0, built.stderr
    replayed = run([tmp_path / "replay"])
    assert replayed.returncode == 0, replayed.stdout
    assert "2000 steps, 0 of " not in replayed.stdout  # musl rounds otherwise, or the test shows nothing
    assert replayed.stdout.strip().endswith("; 0 by more than 1e-9")
