"""Traced functions as machine code, where a C compiler is found."""

import ctypes
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import casadi as ca
import numpy as np

from tarc.core.c_constants import Constants
from tarc.core.c_emitter import StepInterface, emit
from tarc.core.errors import CompilationError, InvalidParameter, MissingTool
from tarc.core.optional import install_command
from tarc.core.types import Array

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None

FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", "-fPIC", "-shared"]
"""No fast mathematics, since the laws rely on comparisons with NaN; no contraction, so that numbers are the same."""

THIS_PROCESSOR = "-march=native"
"""Use all instructions of this processor, where the compiler knows the option. The numbers are the same."""


_used: dict[str, Path] = {}
"""Libraries that this process has needed, by their `library_key`."""

_received: list[Path] = []
"""Folders with libraries of other machines, each named by its `library_key`."""


def compiler() -> list[str]:
    """Return the C compiler's command: ``$CC``, else cc, gcc or clang, else the one in the ``ziglang`` wheel."""
    named = os.environ.get("CC")
    if named:
        return shlex.split(named)
    for name in ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path:
            return [path]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise MissingTool(
        "native: no C compiler found; looked for $CC, cc, gcc, clang and the ziglang package. Install one, for example "
        f"{install_command('ship')}, or leave native out: the virtual machine needs none"
    )


def cache() -> Path:
    """Return the folder of compiled functions: ``$XDG_CACHE_HOME/tarc``, by default ``~/.cache/tarc``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tarc"


def compiled(function: ca.Function) -> ca.Function:
    """Compile a traced function to machine code.

    Raises
    ------
    MissingTool
        When there is no compiler.
    CompilationError
        When the compiler fails, or the cache cannot be written.
    """
    return ca.external(function.name(), str(callable_library(function)))


def callable_library(function: ca.Function) -> Path:
    """Return the library of a traced function, which `casadi.external` takes by the function's name.

    Raises
    ------
    MissingTool, CompilationError
        As `compiled`.
    """
    return compiled_library(_callable_from_casadi(function))


class CompiledLoop:
    """A traced step and its loop over periods in machine code.

    The constants of the step are arguments of the machine code, so that steps with other parameters share it.

    Parameters
    ----------
    function
        ``[state, input] -> [next state, output]``, as `tarc.core.tracing.trace` returns it.

    Raises
    ------
    MissingTool
        When there is no compiler.
    CompilationError
        When the compiler fails, or the cache cannot be written.
    """

    def __init__(self, function: ca.Function):
        self._sizes = function.nnz_in(0), function.nnz_in(1), function.nnz_out(1)
        constants = Constants(in_array=True)
        self._run = ctypes.CDLL(str(compiled_library(_with_loop(function, constants)))).run
        self._run.argtypes = [ctypes.c_long, *[ctypes.c_void_p] * 4]
        self._run.restype = None
        self._constants = np.array(constants.values)

    def run(self, state: Array, inputs: Array) -> Array:
        """Step once per row of the inputs, shape (periods, inputs); return the outputs, shape (periods, outputs).

        The state vector is replaced by that after the last period.
        """
        n_state, n_inputs, n_outputs = self._sizes
        if state.shape != (n_state,) or inputs.shape != (len(inputs), n_inputs):
            raise InvalidParameter(
                f"state, inputs: got shapes {state.shape} and {inputs.shape}; needs ({n_state},) and (k, {n_inputs})"
            )
        inputs = np.ascontiguousarray(inputs, dtype=float)
        outputs = np.empty((len(inputs), n_outputs))
        arrays = state, inputs, outputs, self._constants
        self._run(len(inputs), *(array.ctypes.data for array in arrays))
        return outputs


def _with_loop(function: ca.Function, constants: Constants) -> str:
    """Return C with ``run``, which steps a function period by period with the constants that it is handed."""
    n_state, n_inputs, n_outputs = function.nnz_in(0), function.nnz_in(1), function.nnz_out(1)
    return f"""{emit(function, "step", constants, StepInterface(constants))}
void run(long periods, double *state, const double *inputs, double *outputs, const double *c);
void run(long periods, double *state, const double *inputs, double *outputs, const double *c)
{{
  double next[{max(n_state, 1)}];
  for (long k = 0; k < periods; ++k) {{
    const double *const arg[] = {{state, inputs + {n_inputs} * k}};
    double *const res[] = {{next, outputs + {n_outputs} * k}};
    step(arg, res, c);
    memcpy(state, next, {n_state} * sizeof(double));
  }}
}}
"""


def _callable_from_casadi(function: ca.Function) -> str:
    """Return C with the entry points that ``casadi.external`` looks for."""
    name, n_in, n_out = function.name(), function.n_in(), function.n_out()
    sizes_in = [function.nnz_in(i) for i in range(n_in)]
    sizes_out = [function.nnz_out(i) for i in range(n_out)]
    parts = [
        emit(function, "evaluate"),
        f"long long {name}_n_in(void) {{ return {n_in}; }}",
        f"long long {name}_n_out(void) {{ return {n_out}; }}",
    ]
    for side, count, label, sparsity in (
        ("in", n_in, function.name_in, function.sparsity_in),
        ("out", n_out, function.name_out, function.sparsity_out),
    ):
        for i in range(count):
            pattern = ", ".join(map(str, sparsity(i).compress()))
            parts.append(f"static const long long sparsity_{side}{i}[] = {{{pattern}}};")
        patterns = ", ".join(f"sparsity_{side}{i}" for i in range(count))
        names = ", ".join(f'"{label(i)}"' for i in range(count))
        parts.append(f"static const long long *const sparsities_{side}[] = {{{patterns}}};")
        parts.append(f"static const char *const names_{side}[] = {{{names}}};")
        parts.append(f"const long long *{name}_sparsity_{side}(long long i) {{ return sparsities_{side}[i]; }}")
        parts.append(f"const char *{name}_name_{side}(long long i) {{ return names_{side}[i]; }}")
    parts.append(
        f"""int {name}(const double **arg, double **res, long long *iw, double *w, int mem)
{{
  static const double zero[{max(sizes_in, default=1) or 1}];
  double unused[{max(sizes_out, default=1) or 1}];
  const double *in[{n_in or 1}];
  double *out[{n_out or 1}];
  (void)iw, (void)w, (void)mem;
  for (int i = 0; i < {n_in}; ++i)
    in[i] = arg[i] ? arg[i] : zero;
  for (int i = 0; i < {n_out}; ++i)
    out[i] = res[i] ? res[i] : unused;
  evaluate(in, out);
  return 0;
}}
"""
    )
    return "\n".join(parts)


def compiled_library(code: str, options: Sequence[str] = ()) -> Path:
    """Return the shared library of C source, compiled once and kept by source, command and processor.

    Parameters
    ----------
    code
        C99, or C with the extensions of GCC and Clang.
    options
        Of the compiler, after `FLAGS`.

    Raises
    ------
    MissingTool
        When there is no compiler.
    CompilationError
        When the compiler fails, or the cache cannot be written.
    """
    key = library_key(code, options)
    for folder in _received:
        if (folder / f"{key}.so").is_file():
            return folder / f"{key}.so"
    library = _used[key] = _library_of_this_machine(code, options)
    return library


def library_key(code: str, options: Sequence[str] = ()) -> str:
    """Return what is the same for all machines that can use each other's library of C source: a hash.

    They have the same processor, system and C library. The compiler does not count.
    """
    parts = code, *FLAGS, *options, _processor(), platform.system(), *platform.libc_ver()
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def used_libraries() -> dict[str, Path]:
    """Return the libraries that this process has needed, by their `library_key`."""
    return dict(_used)


def receive_libraries(folder: Path) -> None:
    """Look for libraries in a folder before compiling them; each is named ``KEY.so`` by its `library_key`."""
    if folder not in _received:
        _received.append(folder)


def _library_of_this_machine(code: str, options: Sequence[str]) -> Path:
    """Return the library in the cache, compiled if it is not there."""
    command = [*compiler(), *FLAGS, *options]
    name = hashlib.sha256("\n".join([code, *command, _processor()]).encode()).hexdigest()[:32]
    library = cache() / f"{name}.so"
    if library.is_file():
        return library
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with _one_process_at_a_time(library):
            if not library.is_file():
                _compile_into(library, code, command)
    except OSError as error:
        raise CompilationError(
            f"native: cannot compile into {library.parent}: {error.strerror or error}; set XDG_CACHE_HOME to a "
            "folder that can be written, or leave native out"
        ) from None
    return library


@contextmanager
def _one_process_at_a_time(library: Path) -> Iterator[None]:
    """Let the processes that need the same library wait for the one that compiles it, where files can be locked."""
    lock = library.with_suffix(".lock")
    with lock.open("w") as file:
        if fcntl is not None:
            with suppress(OSError):  # some network file systems have no locks: then several compile the same
                fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def _compile_into(library: Path, code: str, command: list[str]) -> None:
    """Compile C source; the library appears when it is complete."""
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        source = Path(folder, "source.c")
        output = Path(folder, "output.so")
        source.write_text(code)
        files = [str(source), "-lm", "-o", str(output)]
        try:
            _compile([*command, THIS_PROCESSOR, *files])
        except CompilationError:  # the compiler may not know the option; any other fault comes again
            _compile([*command, *files])
        output.replace(library)


def _processor() -> str:
    """Return what tells this processor from others that may share a home folder."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    first, _, _ = text.partition("\n\n")
    names = "vendor_id", "cpu family", "model", "flags", "CPU ", "Features"
    return "\n".join(line for line in first.splitlines() if line.startswith(names))


def _compile(command: list[str]) -> None:
    try:
        process = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise MissingTool(f"native: there is no compiler {command[0]!r}; correct or unset $CC") from None
    if process.returncode:
        message = process.stderr.strip()[-500:] or "it printed nothing"
        raise CompilationError(f"native: {shlex.join(command[:-4])} failed: {message}")
