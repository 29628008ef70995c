"""Platforms of an FMU, and its shared library for each."""

import platform
import struct
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from tarc.core.codegen import compiler
from tarc.core.errors import CompilationError, InvalidParameter, MissingTool
from tarc.core.optional import install_command

OVERRIDE = "FMI3_OVERRIDE_FUNCTION_PREFIX"
"""Defined for a shared library by FMI 3.0, whose functions have no prefix."""
FLAGS = ("-std=c99", "-ffp-contract=off", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-s", f"-D{OVERRIDE}")


class Platform(NamedTuple):
    """Target of the compiler in the ``ziglang`` wheel, ending of a shared library, and the folder's name in FMI 2.0."""

    target: str
    ending: str
    folder: str


PLATFORMS = {
    "x86_64-linux": Platform("x86_64-linux-gnu.2.17", ".so", "linux64"),
    "aarch64-linux": Platform("aarch64-linux-gnu.2.17", ".so", "aarch64-linux"),
    "x86_64-windows": Platform("x86_64-windows-gnu", ".dll", "win64"),
    "x86_64-darwin": Platform("x86_64-macos", ".dylib", "darwin64"),
    "aarch64-darwin": Platform("aarch64-macos", ".dylib", "darwin64"),
}
"""By the names of FMI 3.0. FMI 2.0 has no name for ARM under Linux, and one for both kinds of Mac."""

CPU_TYPES = {"x86_64-darwin": (0x01000007, 3), "aarch64-darwin": (0x0100000C, 0)}
"""Type and subtype of the processor in a library for both kinds of Mac."""
ALIGNMENT = 14
"""Power of two at which each part of such a library starts."""


def this_platform() -> str:
    """Return the platform that Python runs on.

    Raises
    ------
    InvalidParameter
        For one that is not among `PLATFORMS`.
    """
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    name = f"{machine}-{platform.system().lower()}"
    if name not in PLATFORMS:
        raise InvalidParameter(f"platforms: this machine is {name!r}; name the platforms: {', '.join(PLATFORMS)}")
    return name


def check_platforms(platforms: Sequence[str]) -> tuple[str, ...]:
    """Return the platforms, each once.

    Raises
    ------
    InvalidParameter
        For an unknown one.
    """
    for name in platforms:
        if name not in PLATFORMS:
            raise InvalidParameter(f"platforms: got {name!r}; allowed: {', '.join(PLATFORMS)}")
    return tuple(dict.fromkeys(platforms))


def libraries(folder: Path, name: str, sources: Sequence[str], platforms: Sequence[str] | None, version: str) -> dict:
    """Compile the sources in a folder, and return the shared libraries by their path in the FMU.

    Parameters
    ----------
    folder, sources
        Where the sources are, and those of them to compile.
    name
        Of the library, without ending.
    platforms
        Of `PLATFORMS`, compiled by ``ziglang``; None for this machine, by the compiler that is found.
    version
        Of FMI, which names the folders.

    Raises
    ------
    MissingTool
        Without a compiler.
    CompilationError
        Where it fails.
    """
    if platforms is None:
        own = this_platform()
        built = {own: _compile(folder, compiler(), name, sources, own)}
    else:
        built = {target: _compile(folder, _zig(target), name, sources, target) for target in platforms}
    binaries: dict[str, bytes] = {}
    for target, content in built.items():
        place = PLATFORMS[target].folder if version == "2.0" else target
        binaries[f"binaries/{place}/{name}{PLATFORMS[target].ending}"] = content
    if version == "2.0" and set(CPU_TYPES) <= set(built):
        binaries[f"binaries/darwin64/{name}.dylib"] = universal({target: built[target] for target in CPU_TYPES})
    return binaries


def _zig(platform_name: str) -> list[str]:
    if find_spec("ziglang") is None:
        raise MissingTool(f"platforms: needs ziglang, which compiles for all of them; {install_command('ship')}")
    return [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[platform_name].target]


def _compile(folder: Path, command: Sequence[str], name: str, sources: Sequence[str], platform_name: str) -> bytes:
    output = folder / f"{name}-{platform_name}{PLATFORMS[platform_name].ending}"
    options = [*FLAGS, *sources, "-o", output.name, "-lm"]
    try:
        process = subprocess.run([*command, *options], cwd=folder, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise MissingTool(f"export fmu: there is no {command[0]!r}; install it, or set CC to a compiler") from None
    if process.returncode or not output.is_file():
        raise CompilationError(f"export fmu: {platform_name}: {command[0]} failed: {process.stderr.strip()[-800:]}")
    return output.read_bytes()


def universal(parts: dict[str, bytes]) -> bytes:
    """Return one library for both kinds of Mac: a header, then the libraries, each at a multiple of 2^`ALIGNMENT`."""
    header = struct.pack(">II", 0xCAFEBABE, len(parts))
    content, place = b"", 1 << ALIGNMENT
    for platform_name, part in parts.items():
        header += struct.pack(">IIIII", *CPU_TYPES[platform_name], place, len(part), ALIGNMENT)
        padded = part + b"\0" * (-len(part) % (1 << ALIGNMENT))
        content, place = content + padded, place + len(padded)
    return header + b"\0" * ((1 << ALIGNMENT) - len(header)) + content
