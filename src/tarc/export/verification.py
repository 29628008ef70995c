"""Whether exported C is the law: compiled, replayed and compared bit by bit."""

import ctypes
import hashlib
import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tarc.control.watch import Watch
from tarc.core.codegen import compiler
from tarc.core.errors import CompilationError, InvalidParameter, MissingTool
from tarc.core.files import read_text
from tarc.core.types import Array
from tarc.export import vectors
from tarc.export.c_source import COUNTS, FLAG_COMMENTS, CSource
from tarc.export.traced_law import Signal, traced_law
from tarc.laws.base import Law
from tarc.signals.torque_limits import TorqueLimits

BASE_FLAGS = ("-std=c99", "-ffp-contract=off")
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Wmissing-prototypes")
LEVELS = ("-O2", "-O3")
TIMED_STEPS = 200_000
TOLERANCES = {"double": 1e-9, "float": 1e-3}
"""Largest difference, relative to one more than the number, for a law with functions that libraries round."""
REPLAYED = re.compile(r"(\d+) steps, (\d+) of (\d+) numbers differ, by (\d+) units")
TIMED = re.compile(r"([\d.]+) ns per step")


@dataclass(frozen=True)
class ReplayResult:
    """Replay of the recorded steps by one compiler and level of optimisation.

    Attributes
    ----------
    command
        Compiler and options.
    warnings
        What the compiler printed with the warnings on; empty for none.
    passed
        Whether the replay says so.
    different, total
        Numbers that differ, and all numbers.
    step_time
        Of one step [s].
    """

    command: str
    warnings: str
    passed: bool
    different: int
    total: int
    step_time: float


@dataclass(frozen=True)
class Comparison:
    """Random steps of the C against the law itself.

    Attributes
    ----------
    steps
        Number of steps.
    different
        Numbers that differ in a bit.
    largest
        Largest difference over one more than the number's magnitude.
    decisions
        Steps in which missing samples or faults differ.
    torque_difference
        For ``float``: largest difference of a torque from that of the law in double precision [N m or N].
    """

    steps: int
    different: int
    largest: float
    decisions: int
    torque_difference: float


@dataclass(frozen=True)
class ExportReport:
    """What `verify_export` found.

    Attributes
    ----------
    name, real
        Of the C.
    is_unchanged
        Whether header and source have the hash in ``law.yaml``.
    is_same_law
        Whether the law in ``law.yaml`` gives the same bytes; None where the file does not hold it.
    replays
        One for each level of optimisation.
    comparison
        Random steps against the law; None where ``law.yaml`` does not hold it.
    code_size
        Of the machine code [bytes]; None where it is unknown.
    stack
        Of a step [bytes]; None where the compiler does not tell.
    parts
        What the test of the law's parts printed; None where they are not there.
    parts_passed
        Whether it passed, without warnings of the compiler.
    """

    name: str
    real: str
    is_unchanged: bool
    is_same_law: bool | None
    replays: tuple[ReplayResult, ...]
    comparison: Comparison | None
    code_size: int | None
    stack: int | None
    parts: str | None = None
    parts_passed: bool = True

    @property
    def passed(self) -> bool:
        """Whether the C is the law, as far as was tested."""
        limits = TOLERANCES[self.real]
        compared = self.comparison is None or (self.comparison.decisions == 0 and self.comparison.largest <= limits)
        replayed = all(replay.passed and not replay.warnings for replay in self.replays)
        same = self.is_unchanged and self.is_same_law is not False
        return same and compared and replayed and self.parts_passed


def verify_export(
    folder: str | Path,
    *,
    law: Law | None = None,
    torque_limits: TorqueLimits | None = None,
    command: Sequence[str] | None = None,
    steps: int = 100_000,
    seed: int = 1,
) -> ExportReport:
    """Compile exported C, replay its vectors, and compare random steps with the law.

    Parameters
    ----------
    folder
        What `export_c` wrote.
    law, torque_limits
        The law, to compare with; None to compare the recorded steps only.
    command
        The compiler; None for the one that is found.
    steps, seed
        Of the random comparison.

    Raises
    ------
    InvalidParameter
        For a folder without an export.
    MissingTool
        Without a compiler.
    CompilationError
        Where it fails.
    """
    root, content = Path(folder), read_law_yaml(folder)
    name, real = str(content["name"]), str(content["real"])
    header, source = (read_text("folder", root / "src" / f"{name}{end}") for end in (".h", ".c"))
    unchanged = hashlib.sha256((header + source).encode()).hexdigest() == content["sha256"]
    command = list(command or compiler())
    watch = Watch(**numbers_of(content["watch"])) if "watch" in content else None
    same, comparison = None, None
    with tempfile.TemporaryDirectory() as work:
        replays = tuple(_replay(root, name, [*command, level], Path(work)) for level in LEVELS)
        code_size, stack = _sizes(root, name, command, Path(work))
        parts, parts_passed = None, True
        if "parts" in content:
            parts, parts_passed = _parts(root, name, [*command, LEVELS[0]], Path(work))
            unchanged = unchanged and _parts_digest(root, name) == content["parts"]["sha256"]
        if law is not None:
            title, commands = f"{name}: {type(law).__name__}", tuple(content.get("commands", ()))
            fresh = CSource(traced_law(law, torque_limits, watch), name, real == "float", title, commands)
            same = fresh.header == header and fresh.source == source
            comparison = _compare(fresh, command, Path(work), steps, seed)
    return ExportReport(name, real, unchanged, same, replays, comparison, code_size, stack, parts, parts_passed)


def numbers_of(parameters: dict[str, Any]) -> dict[str, Any]:
    """Return parameters of a watch as ``law.yaml`` has them, with infinities as numbers."""

    def plain(value: Any) -> Any:
        if isinstance(value, list):
            return [plain(entry) for entry in value]
        return float(value) if isinstance(value, str) else value

    return {name: plain(value) for name, value in parameters.items()}


def read_law_yaml(folder: str | Path) -> dict[str, Any]:
    """Return the sections of an export's ``law.yaml``; ``scenario`` as a dictionary where it is there.

    Raises
    ------
    InvalidParameter
        For a folder without one, and one that cannot be read.
    """
    file = Path(folder) / "law.yaml"
    if not file.is_file():
        raise InvalidParameter(f"folder: {folder} has no law.yaml; give a folder that tarc export c wrote")
    content: dict[str, Any] = {}
    for line in read_text("folder", file).splitlines():
        key, _, value = line.partition(": ")
        if value and not key.startswith(" "):
            try:
                content[key] = json.loads(value)
            except ValueError:
                raise InvalidParameter(f"folder: {file} was changed, {key} cannot be read; export again") from None
    if missing := {"name", "real", "sha256"} - set(content):
        raise InvalidParameter(f"folder: {file} lacks {', '.join(sorted(missing))}; export again")
    return content


def run_command(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a command, whatever its exit status is.

    Raises
    ------
    MissingTool
        Where it does not exist.
    """
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise MissingTool(f"verify-export: there is no {command[0]!r}; install it, or name another compiler") from None


def compile_c(command: Sequence[str]) -> str:
    """Run a compiler and return what it printed.

    Raises
    ------
    MissingTool
        Where it does not exist.
    CompilationError
        Where it fails.
    """
    process = run_command(command)
    if process.returncode:
        raise CompilationError(f"verify-export: {command[0]} failed: {process.stderr.strip()[-800:]}")
    return process.stderr.strip()


def _replay(root: Path, name: str, command: Sequence[str], work: Path) -> ReplayResult:
    binary = str(work / "replay")
    sources = [str(root / "src" / f"{name}.c"), str(root / "test" / "replay.c")]
    includes = [f"-I{root / 'src'}", f"-I{root / 'test'}"]
    printed = compile_c([*command, *BASE_FLAGS, *WARNINGS, *includes, *sources, "-o", binary, "-lm"])
    process = run_command([binary, str(TIMED_STEPS)])
    replayed, timed = REPLAYED.search(process.stdout), TIMED.search(process.stdout)
    if replayed is None or timed is None:
        raise CompilationError(f"verify-export: the replay stopped: {process.stdout.strip() or process.returncode}")
    different, total = int(replayed[2]), int(replayed[3])
    return ReplayResult(
        " ".join(Path(word).name for word in command),
        printed,
        process.returncode == 0,
        different,
        total,
        1e-9 * float(timed[1]),
    )


def _parts(root: Path, name: str, command: Sequence[str], work: Path) -> tuple[str, bool]:
    """Compile and run the test of the parts; return what it printed, and whether it passed."""
    binary = str(work / "parts")
    sources = [str(root / "src" / f"{name}_parts.c"), str(root / "test" / "parts.c")]
    includes = [f"-I{root / 'src'}", f"-I{root / 'test'}"]
    printed = compile_c([*command, *BASE_FLAGS, *WARNINGS, *includes, *sources, "-o", binary, "-lm"])
    process = run_command([binary])
    return (printed or process.stdout.strip()), process.returncode == 0 and not printed


def _parts_digest(root: Path, name: str) -> str:
    header, source = (read_text("folder", root / "src" / f"{name}_parts{end}") for end in (".h", ".c"))
    return hashlib.sha256((header + source).encode()).hexdigest()


def _sizes(root: Path, name: str, command: Sequence[str], work: Path) -> tuple[int | None, int | None]:
    """Return the size of the machine code and the stack of a step, where compiler and binutils tell."""
    output = work / f"{name}.o"
    flags = [*BASE_FLAGS, "-O2", f"-I{root / 'src'}", "-c", str(root / "src" / f"{name}.c"), "-o", str(output)]
    tells_stack = run_command([*command, *flags, "-fstack-usage"]).returncode == 0
    if not tells_stack:
        compile_c([*command, *flags])
    code = None
    if shutil.which("size"):
        rows = run_command(["size", str(output)]).stdout.splitlines()
        code = int(rows[1].split()[0]) if len(rows) > 1 else None
    usage = output.with_suffix(".su")
    rows = usage.read_text(encoding="utf-8").splitlines() if usage.is_file() else []
    frames = [int(row.split("\t")[1]) for row in rows if not row.split("\t")[0].endswith("_reset")]
    return code, sum(sorted(frames)[-2:]) if frames else None


def _compare(source: CSource, command: Sequence[str], work: Path, steps: int, seed: int) -> Comparison | None:
    """Run random steps in the C and in the law."""
    steps = min(steps, 2000) if source.single else steps  # the law in single precision is interpreted
    position, torque, inputs = vectors.inputs_of(source, steps, seed)
    expected = vectors.record(source, position, torque, inputs)
    outputs = run_compiled(source, [*command, "-O2"], expected, work)
    real = np.float32 if source.single else np.float64
    same = (outputs.view(np.uint32 if source.single else np.uint64)) == expected.outputs.astype(real).view(
        np.uint32 if source.single else np.uint64
    )
    with np.errstate(invalid="ignore", over="ignore"):
        differences = np.abs(outputs.astype(float) - expected.outputs.astype(float))
        relative = np.where(same, 0.0, differences / (1 + np.abs(expected.outputs.astype(float))))
    counts = [signal.start for signal in source.traced.signals if signal.name in ("missing", "fault")]
    decisions = int(np.sum(np.any(outputs[:, counts] != expected.outputs[:, counts], axis=1)))
    torque_difference = 0.0
    if source.single:
        double = CSource(source.traced, source.name, False, source.title)
        exact = vectors.record(double, position, torque, inputs).outputs
        n = source.traced.n_joints
        decisions += int(np.sum(np.any(outputs[:, counts] != exact[:, counts], axis=1)))
        torque_difference = float(np.max(np.abs(outputs[:, :n].astype(float) - exact[:, :n])))
    return Comparison(steps, int(np.sum(~same)), float(np.max(relative)), decisions, torque_difference)


def run_compiled(source: CSource, command: Sequence[str], recorded: vectors.Vectors, work: Path) -> Array:
    """Compile a law and return its outputs for recorded inputs, shape (k, m).

    Parameters
    ----------
    source
        The law in C.
    command
        Compiler and options.
    recorded
        Start and inputs.
    work
        Folder for files of the compiler.

    Raises
    ------
    MissingTool
        Without the compiler.
    CompilationError
        Where it fails.
    """
    folder = Path(tempfile.mkdtemp(dir=work))  # each library needs a name of its own to be loaded
    library, file = folder / "law.so", folder / f"{source.name}.c"
    file.with_suffix(".h").write_text(source.header, encoding="utf-8")
    file.write_text(source.source, encoding="utf-8")
    compile_c([*command, *BASE_FLAGS, "-fPIC", "-shared", str(file), "-o", str(library), "-lm"])
    n, c_real = source.traced.n_joints, ctypes.c_float if source.single else ctypes.c_double
    real = np.float32 if source.single else np.float64
    kinds = dict.fromkeys(COUNTS, ctypes.c_int) | dict.fromkeys(FLAG_COMMENTS, ctypes.c_uint)
    fields: list[tuple[str, Any]] = [("torque", c_real * n)]
    fields += [(signal.name, kinds.get(signal.name, c_real * signal.size)) for signal in source.signals]
    output_type = type("Output", (ctypes.Structure,), {"_fields_": fields})
    state_type = type(
        "State",
        (ctypes.Structure,),
        {"_fields_": [("x", c_real * (2 * source.traced.n_states)), ("now", ctypes.c_int), ("ready", ctypes.c_int)]},
    )
    loaded = ctypes.CDLL(str(library))
    reset, step = loaded[f"{source.name}_reset"], loaded[f"{source.name}_step"]
    state, output = state_type(), output_type()
    with np.errstate(over="ignore"):  # absurd numbers are infinite in single precision
        start = [np.ascontiguousarray(part, dtype=real) for part in (recorded.position, recorded.torque)]
        inputs = np.ascontiguousarray(recorded.inputs, dtype=real)
    reset(ctypes.byref(state), *(ctypes.c_void_p(part.ctypes.data) for part in start))
    results = np.empty(recorded.outputs.shape, dtype=real)
    width, size = inputs.strides[0], ctypes.byref(output)
    for k in range(len(inputs)):
        step(ctypes.byref(state), ctypes.c_void_p(inputs.ctypes.data + k * width), size)
        for signal in (Signal("torque", 0, n), *source.signals):
            results[k, signal.start : signal.start + signal.size] = getattr(output, signal.name)
    return results
