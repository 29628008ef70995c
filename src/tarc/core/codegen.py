"""Traced functions as machine code, where a C compiler is found."""

import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import casadi as ca

from tarc.core.errors import CompilationError, MissingTool

FLAGS = ["-O2", "-fPIC", "-shared"]
"""No fast mathematics: the laws rely on what comparisons with NaN give."""


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
        "pip install 'tarc-control[ship]', or leave native out: the virtual machine needs none"
    )


def cache() -> Path:
    """Return the folder of compiled functions: ``$XDG_CACHE_HOME/tarc``, by default ``~/.cache/tarc``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tarc"


def compiled(function: ca.Function) -> ca.Function:
    """Compile a function to machine code.

    The C that CasADi generates is compiled once and kept under the hash of its text and of the compiler's command, so
    that the next call with the same equations and numbers only loads it.

    Raises
    ------
    MissingTool
        When there is no compiler.
    CompilationError
        When the compiler fails, or the cache cannot be written.
    """
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    code, command = generator.dump(), [*compiler(), *FLAGS]
    name = hashlib.sha256("\n".join([code, *command, ca.CasadiMeta.version()]).encode()).hexdigest()[:32]
    library = cache() / f"{name}.so"
    if not library.is_file():
        try:
            library.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=library.parent) as folder:
                source = Path(folder, f"{function.name()}.c")
                output = Path(folder, "output.so")
                source.write_text(code)
                command += [str(source), "-lm", "-o", str(output)]
                try:
                    process = subprocess.run(command, capture_output=True, text=True, check=False)
                except FileNotFoundError:
                    raise MissingTool(f"native: there is no compiler {command[0]!r}; correct or unset $CC") from None
                if process.returncode:
                    message = process.stderr.strip()[-500:] or "it printed nothing"
                    raise CompilationError(f"native: {shlex.join(command[:-4])} failed: {message}")
                output.replace(library)
        except OSError as error:
            raise CompilationError(
                f"native: cannot compile into {library.parent}: {error.strerror or error}; set XDG_CACHE_HOME to a "
                "folder that can be written, or leave native out"
            ) from None
    return ca.external(function.name(), str(library))
