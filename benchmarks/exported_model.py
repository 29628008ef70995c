"""Exported laws with a model and with functions of the C library, and the way from the command to a replayed binary.

A part of ``python -m benchmarks.export``.
"""

import re
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import tarc
from tarc.export import export_c, vectors, verify_export
from tarc.export.c_source import CSource
from tarc.export.traced_law import traced_law
from tarc.export.verification import BASE_FLAGS, compile_c, run_command

MODEL_GOAL = 1.5e-6
"""Longest step with M̂(q) of six joints [s]."""

COMMAND_GOAL = 10.0
"""Longest time from the command to a replayed binary [s]."""

LIBRARY_STEPS = 5000
"""Random steps of each law that are compared between C libraries."""

MUSL = (sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-linux-musl", "-static", "-O2")
GLIBC = ("gcc", "-O2")
REPLAYED = re.compile(r"(\d+) of (\d+) numbers differ, by (\d+) units of the last place at most; (\d+) by more")


def with_model(arm: tarc.plants.Plant) -> tarc.laws.TDC:
    """Return a law with M̂(q) and the gravity of a robot."""
    return tarc.laws.TDC(
        inertia=tarc.NominalInertia(arm, 0.2, gravity=True),
        natural_frequency=20.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.016, degree=2),
        torque_limit=np.full(arm.n_joints, 100.0),
    )


def report(console: Console, laws: dict[str, tarc.laws.Law]) -> None:
    """Print the step with M̂(q), what C libraries change, and the time from the command to a replayed binary."""
    law = with_model(tarc.plants.load_robot("ur5e", armature=0.1))
    with tempfile.TemporaryDirectory() as folder:
        export_c(law, folder, name="arm")
        replays = verify_export(folder, steps=100, command=["gcc"]).replays
    cells = ", ".join(f"{replay.command} {1e6 * replay.step_time:.2f} µs" for replay in replays)
    met = "yes" if all(replay.step_time <= MODEL_GOAL for replay in replays) else "no"
    console.print(f"\nA step of TDC with M̂(q) and gravity of a UR5e: {cells}; ≤ 1.5 µs: {met}", highlight=False)
    libraries(console, laws | {"TDC with M̂(q)": with_model(tarc.plants.TwoLinkArm())})
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        ends_well = replay_command(Path(folder))
        seconds = time.perf_counter() - begin
    met = "yes" if ends_well and seconds <= COMMAND_GOAL else "no"
    console.print(f"\ntarc export c ur5e to a replayed binary: {seconds:.1f} s; ≤ 10 s: {met}", highlight=False)


def replay_command(folder: Path) -> bool:
    """Export by the command, compile, and return whether the replay agrees in every bit."""
    run_command(
        [sys.executable, "-m", "tarc", "export", "c", "ur5e", "--law", "TARC", "--name", "arm", "-o", str(folder)]
    )
    return replay(folder, GLIBC)[1] == 0


def replay(folder: Path, command: Sequence[str]) -> tuple[int, int, int, int]:
    """Return numbers, those that differ, by how many units of the last place, and those beyond rounding."""
    binary = str(folder / "replay")
    includes = [f"-I{folder}/src", f"-I{folder}/test"]
    compile_c([*command, *BASE_FLAGS, *includes, f"{folder}/src/arm.c", f"{folder}/test/replay.c", "-lm", "-o", binary])
    found = REPLAYED.search(run_command([binary]).stdout)
    assert found is not None
    different, total, units, wrong = map(int, found.groups())
    return total, different, units, wrong


def libraries(console: Console, laws: dict[str, tarc.laws.Law]) -> None:
    """Print what the C libraries glibc and musl change in laws that call sin, cos, exp, pow or tanh."""
    table = Table("law", "numbers", "glibc", "musl", "units of the last place", "beyond rounding, decisions among them")
    for name, law in laws.items():
        source = CSource(traced_law(law), "arm", False, "")
        if not source.uses_library:
            continue
        with tempfile.TemporaryDirectory() as folder:
            export_c(law, folder, name="arm")
            recorded = vectors.record(source, *vectors.inputs_of(source, LIBRARY_STEPS, 1))
            (Path(folder) / "test" / "vectors.h").write_text(vectors.header(source, recorded), encoding="utf-8")
            total, same, _, _ = replay(Path(folder), GLIBC)
            _, different, units, wrong = replay(Path(folder), MUSL)
        table.add_row(name, str(total), str(same), str(different), str(units), str(wrong))
    console.print(
        f"\nNumbers of {LIBRARY_STEPS} random steps that differ from the simulation with glibc, of laws that call libm",
        highlight=False,
    )
    console.print(table)
