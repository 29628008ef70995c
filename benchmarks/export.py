"""What exported C reaches, in one run: ``python -m benchmarks.export``, or ``make bench-export``.

For every law it counts the numbers that differ from the virtual machine over random steps. Two percent of them have
something missing, infinite or absurd. It does so with gcc at two levels, with zig, and on aarch64 under QEMU with musl.
In single precision it counts the decisions that differ from those in double precision.

Then it times a step of literal TARC for six joints and a window of 16 periods. Beside it stands a C step of the same
law by hand, with a ring buffer, which gives the same torque.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import tarc
from benchmarks import exported_model, fmu
from benchmarks.__main__ import machine
from benchmarks.measure import law as tarc_law
from tarc.core.types import Array
from tarc.export import export_c, vectors, verify_export
from tarc.export.c_source import CSource
from tarc.export.traced_law import traced_law
from tarc.export.verification import BASE_FLAGS, compile_c, run_command, run_compiled

HERE = Path(__file__).parent
ZIG = (sys.executable, "-m", "ziglang", "cc")
COMPILERS = {"gcc -O2": ("gcc", "-O2"), "gcc -O3": ("gcc", "-O3"), "zig -O2": (*ZIG, "-O2")}
SINGLE = ("gcc", "-O2")
GOAL = 1.7
"""Largest ratio of the exported step's time to that by hand."""
TORQUE_TOLERANCE = 1e-9


def laws() -> dict[str, tarc.laws.Law]:
    """Return every law of the package, for two joints."""
    sys.path.insert(0, str(HERE.parent / "tests"))
    from law_catalogue import concrete_laws, make_law

    return {kind.__name__: make_law(kind) for kind in concrete_laws()}


def same_bits(law: tarc.laws.Law, steps: int) -> list[str]:
    """Return the cells of a law: numbers that differ by compiler, then single precision against double."""
    traced = traced_law(law)
    double, single = CSource(traced, "law", False, ""), CSource(traced, "law", True, "")
    expected = vectors.record(double, *vectors.random_inputs(law.n_joints, steps, 1))
    cells = [str(expected.outputs.size)]
    with tempfile.TemporaryDirectory() as folder:
        for name, command in COMPILERS.items():
            if shutil.which(command[0]) is None:
                cells.append(f"no {name}")
                continue
            found = run_compiled(double, command, expected, Path(folder))
            cells.append(different(found, expected.outputs))
        cells.append(different_on_aarch64(law, expected, Path(folder)))
        found = run_compiled(single, SINGLE, expected, Path(folder)).astype(float)
    return [*cells, *single_against_double(found, expected.outputs, double)]


def different_on_aarch64(law: tarc.laws.Law, expected: vectors.Vectors, folder: Path) -> str:
    """Return what differs on a 64-bit ARM processor, emulated by QEMU, with musl as its C library."""
    if shutil.which("qemu-aarch64") is None:
        return "no qemu-aarch64"
    root = folder / "aarch64"
    export_c(law, root, name="arm")
    binary, inputs = root / "stream", root / "inputs"
    start = np.concatenate([expected.position, expected.torque])
    inputs.write_bytes(start.tobytes() + np.ascontiguousarray(expected.inputs).tobytes())
    files = [f"-I{root / 'src'}", f"-I{root / 'test'}", root / "src" / "arm.c", HERE / "export_stream.c", "-lm"]
    compile_c(
        [*ZIG, "-target", "aarch64-linux-musl", "-static", "-O2", *BASE_FLAGS, *map(str, files), "-o", str(binary)]
    )
    with inputs.open("rb") as source:
        process = subprocess.run(["qemu-aarch64", str(binary)], stdin=source, capture_output=True, check=True)
    found = np.frombuffer(process.stdout).reshape(expected.outputs.shape)
    return different(found, expected.outputs)


def different(found: Array, expected: Array) -> str:
    """Return the number of bit patterns that differ, with the largest relative difference where there are some."""
    differs = found.view(np.uint64) != expected.view(np.uint64)
    count = int(np.sum(differs))
    if not count:
        return "0"
    relative = np.abs(found - expected)[differs] / (1 + np.abs(expected[differs]))
    return f"{count}, by {np.max(relative):.1e}"


def single_against_double(found: Array, expected: Array, source: CSource) -> list[str]:
    """Return steps with another count of missing samples or fault, with another choice of the law, and torques."""
    counts = [signal.start for signal in source.signals if signal.name in ("missing", "fault")]
    decisions = np.any(found[:, counts] != expected[:, counts], axis=1)
    n = source.traced.n_joints
    choices = [place for place in range(n, expected.shape[1]) if set(np.unique(expected[:, place])) <= {0.0, 1.0}]
    choices = [place for place in choices if place not in counts]
    others = np.any(found[:, choices] != expected[:, choices], axis=1) if choices else None
    torque = f"{np.max(np.abs(found[:, :n] - expected[:, :n])):.1e} of {np.max(np.abs(expected[:, :n])):.1f}"
    return [str(int(np.sum(decisions))), "-" if others is None else str(int(np.sum(others))), torque]


def fuzz(console: Console, steps: int) -> None:
    """Print what absurd inputs do to the C of every law, in both precisions and under the sanitizers of gcc."""
    table = Table("law", "double", "float", "steps with missing samples", "in a fault", "starts refused")
    sanitizers = ("-O1", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
    for name, law in laws().items():
        limited = replace(law, torque_limit=np.full(law.n_joints, 5.0))
        cells, counts = [], [0, 0, 0]
        for real in ("double", "float"):
            with tempfile.TemporaryDirectory() as folder:
                export_c(limited, folder, name="arm", real=real)
                binary = str(Path(folder) / "fuzz")
                files = [f"-I{folder}/src", f"{folder}/src/arm.c", f"{folder}/test/fuzz.c", "-lm", "-o", binary]
                compile_c(["gcc", *BASE_FLAGS, *sanitizers, *files])
                process = run_command([binary, str(steps)])
            found = re.findall(r"\d+", process.stdout)
            cells.append("crashed" if len(found) != 8 else f"{found[1]} not finite, {found[2]} beyond")
            if len(found) == 8:
                counts = [count + int(found[place]) for count, place in zip(counts, (4, 5, 7), strict=True)]
        table.add_row(name, *cells, *map(str, counts))
    console.print(
        f"\n{steps} absurd steps of each law: torques that are not finite, or beyond the limit", highlight=False
    )
    console.print(table)


def six_joints() -> tarc.laws.TARC:
    """Return the law that is timed."""
    return tarc_law(np.full(6, 0.1), 16, 50.0, np.full(6, 100.0))


def step_time(console: Console) -> None:
    """Print the time of the exported step and of that by hand, with code size and stack."""
    law = six_joints()
    table = Table("compiler", "exported", "by hand", "ratio", f"≤ {GOAL:g}", "torques differ by", "decisions differ")
    with tempfile.TemporaryDirectory() as folder:
        export_c(law, folder, name="arm")
        for name, command in COMPILERS.items():
            if shutil.which(command[0]) is None:
                continue
            torque, decisions, exported, by_hand = times(law, command, Path(folder))
            ratio = exported / by_hand
            met = "yes" if torque <= TORQUE_TOLERANCE and decisions == 0 and ratio <= GOAL else "no"
            row = f"{exported:.0f} ns", f"{by_hand:.0f} ns", f"{ratio:.2f}", met, f"{torque:.1e}", f"{decisions:.0f}"
            table.add_row(name, *row)
        report = verify_export(folder, steps=100, command=["gcc"])
    console.print(
        "\nA step of literal TARC, 6 joints, window 16: the least of 60 rounds, taken in turns", highlight=False
    )
    console.print(table)
    console.print(f"machine code {report.code_size} bytes, stack {report.stack} bytes (gcc -O2)", highlight=False)


def times(law: tarc.laws.TARC, command: Sequence[str], root: Path) -> tuple[float, float, float, float]:
    """Return by how much torques differ, how many decisions do, and both times of a step [ns].

    Parameters
    ----------
    law
        Literal TARC for six joints, whose C with the name arm is in ``root``.
    command
        Compiler and options.
    root
        Folder of the export.
    """
    (root / "parameters.h").write_text(parameters(law), encoding="utf-8")
    sources = [root / "src" / "arm.c", HERE / "handwritten_tarc.c", HERE / "export_timing.c"]
    includes = [f"-I{path}" for path in (root, root / "src", root / "test", HERE)]
    compile_c([*command, *BASE_FLAGS, *includes, *map(str, sources), "-lm", "-o", str(root / "timing")])
    _, torque, decisions, exported, by_hand = map(float, run_command([str(root / "timing")]).stdout.split())
    return torque, decisions, exported, by_hand


def parameters(law: tarc.laws.TARC) -> str:
    """Return parameters.h of the step by hand."""
    estimator = law.estimator
    assert isinstance(estimator, tarc.estimators.Algebraic)
    arrays = {
        "PREDICTION": estimator.prediction,
        "VELOCITY": estimator.weights(1),
        "ACCELERATION": estimator.weights(2),
    }
    numbers = {
        "PERIOD": law.period,
        "INERTIA": 0.1,
        "POSITION_GAIN": law.K1[0, 0],
        "VELOCITY_GAIN": law.K2[0, 0],
        "LAYER": law.boundary_layer,
        "MIN_GAIN": law.min_gain,
        "START_GAIN": law.start_gain,
        "RISE_RATE": law.rise_rate,
        "FALL_RATE": law.fall_rate,
        "TORQUE_LIMIT": float(law.torque_limits[0]),
        "MAX_MISSING": law.max_missing,
    }
    lines = [f"#define {name} {float(value)!r}" for name, value in numbers.items()]
    lines += [
        f"static const double {name}[SAMPLES] = {{{', '.join(repr(float(one)) for one in values)}}};"
        for name, values in arrays.items()
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print everything; it reports, so that it exits with 0 whatever the numbers are."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.export", description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000, help="random steps of each law")
    parser.add_argument("--fuzz", type=int, default=1_000_000, help="absurd steps of each law")
    arguments = parser.parse_args()
    steps = arguments.steps
    console = Console(width=None if Console().is_terminal else 160)
    console.print(machine(), highlight=False)
    table = Table("law", "numbers", *COMPILERS, "aarch64", "float: missing, fault", "choices", "torque [N m]")
    for name, law in laws().items():
        table.add_row(name, *same_bits(law, steps))
    console.print(f"Numbers of {steps} random steps that differ from the virtual machine, 2 joints", highlight=False)
    console.print(table)
    if shutil.which("gcc"):
        fuzz(console, arguments.fuzz)
    step_time(console)
    exported_model.report(console, laws())
    fmu.report(console)


if __name__ == "__main__":
    main()
