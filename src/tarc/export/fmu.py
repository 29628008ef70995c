"""A law as a Functional Mock-up Unit."""

import hashlib
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.files import make_folder, read_text, writing
from tarc.core.optional import require
from tarc.export.c_project import POSITION_UNITS, c_name, inner_loop_units, law_yaml, licence
from tarc.export.c_source import CSource
from tarc.export.fmu_description import FmuFacts, build_description, description_2, description_3
from tarc.export.fmu_platforms import check_platforms, libraries
from tarc.export.fmu_variables import Variable, fmu_variables
from tarc.export.traced_law import traced_law
from tarc.export.tunable import Tunable, tunable_law
from tarc.laws.base import Law
from tarc.signals.torque_limits import TorqueLimits

VERSIONS = ("2.0", "3.0")
HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
"""Headers of the standard, in FMPy's copy."""
WRAPPERS = {"2.0": "fmi2.c", "3.0": "fmi3.c"}
PREFIX = """/* Names of functions in a program that links this source; a shared library overrides it. */
#if !defined(FMI3_FUNCTION_PREFIX)
#define FMI3_FUNCTION_PREFIX {}_
#endif

"""
"""Before the headers of FMI 3.0, as its section 2.2.2 asks; those of FMI 2.0 leave no way to override it."""
COMMENT = b"tarc export fmu "
"""Start of the archive's comment; then the hash of its content."""
TIME = (1980, 1, 1, 0, 0, 0)
"""Time of all files in the archive, so that the same law gives the same bytes."""


@dataclass(frozen=True)
class Fmu:
    """What was exported.

    Attributes
    ----------
    file
        The FMU.
    name
        Its model identifier, and prefix of the law's names in C.
    fmi
        ``2.0`` or ``3.0``.
    libraries
        Paths of the shared libraries in the FMU.
    tunable
        Parameters that may change while it runs.
    fixed
        Why the other numbers of the law may not, by name.
    """

    file: Path
    name: str
    fmi: str
    libraries: tuple[str, ...]
    tunable: tuple[str, ...]
    fixed: dict[str, str]


def export_fmu(
    law: Law,
    file: str | Path,
    *,
    name: str | None = None,
    fmi: str = "2.0",
    platforms: Sequence[str] | None = None,
    tunable: Sequence[str] | None = None,
    torque_limits: TorqueLimits | None = None,
    joint_names: Sequence[str] = (),
    certificate: Mapping[str, Any] | None = None,
    scenario: Mapping[str, Any] | None = None,
    commands: Sequence[str] = (),
) -> Fmu:
    """Write a law as an FMU for co-simulation and model exchange: the step that is simulated and certified, in C.

    Without event mode a co-simulation applies a torque one period late, by the standard. Model exchange does not, nor
    co-simulation of FMI 3.0 in event mode. The FMU has its sources, saves and restores its state, and needs no Python.

    Parameters
    ----------
    law
        Any law of `tarc.laws`, or your own.
    file
        What to write, such as ``build/arm.fmu``. An FMU that this function wrote before is replaced.
    name
        Model identifier; None for the file's name.
    fmi
        ``2.0``, where each element of an array is a variable, or ``3.0``, with arrays.
    platforms
        Of ``x86_64-linux``, ``aarch64-linux``, ``x86_64-windows``, ``x86_64-darwin`` and ``aarch64-darwin``, compiled
        by the ``ziglang`` wheel. None for this machine, with the compiler that is found; empty for the sources alone.
    tunable
        Parameters of the law that may change while it runs; None for all that can, empty for none.
    torque_limits
        Limits of the robot's interface, as for `Controller`.
    joint_names
        Names of the joints, in order, for the descriptions of the variables.
    certificate, scenario
        For ``resources/law.yaml``, as for `export_c`.
    commands
        Units of what the law commands where that is no torque, as for `export_c`.

    Raises
    ------
    InvalidParameter
        For a name that is none in C, an unknown platform or parameter, and a file that something else wrote.
    UnsupportedLaw
        For a law that has no C, and a parameter in ``tunable`` that cannot change.
    MissingTool
        Without ``fmpy``, whose copy of the standard's headers is taken, and without a compiler.
    CompilationError
        Where the compiler fails.

    Examples
    --------
    >>> import tempfile, tarc
    >>> law = tarc.laws.TDC(inertia=[0.1], natural_frequency=10.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010))
    >>> written = tarc.export.export_fmu(law, f"{tempfile.mkdtemp()}/joint.fmu")
    >>> written.tunable
    ('inertia', 'natural_frequency', 'damping_ratio')
    """
    check.one_of("fmi", fmi, VERSIONS)
    require("ship", "the export of FMUs", "fmpy")
    file = Path(file)
    name = c_name(file.stem if name is None else name, given=name is not None)
    chosen = None if platforms is None else check_platforms(platforms)
    _check_replaceable(file)
    changeable = tunable_law(law, traced_law(law, torque_limits), tunable)
    inner = inner_loop_units(law, commands)
    source = CSource(changeable.traced, name, False, f"{name}: {type(law).__name__}", inner)
    variables = fmu_variables(source, changeable.tunables, joint_names)
    digest = hashlib.sha256((source.header + source.source).encode()).hexdigest()
    content = {
        **_texts(source, fmi, variables, changeable.tunables),
        "resources/law.yaml": law_yaml(
            law, name, "double", digest, joint_names, certificate, scenario, None, None, inner
        ),
        "documentation/index.html": _page(source, variables, changeable.refused),
        "documentation/licenses/license.txt": licence(),
        "documentation/licenses/fmi.txt": _notice(fmi),
    }
    compiled = _compile(content, name, fmi, chosen)
    _write(file, {path: text.encode() for path, text in content.items()} | compiled)
    names = tuple(tunable.name for tunable in changeable.tunables)
    return Fmu(file, name, fmi, tuple(compiled), names, changeable.refused)


def _texts(source: CSource, fmi: str, variables: list[Variable], tunables: Sequence[Tunable]) -> dict[str, str]:
    """Return model description and sources by their path in the FMU."""
    wrapper, name = WRAPPERS[fmi], source.name
    own = {f"sources/{file}": read_text("fmi", Path(__file__).parent / "fmi" / file) for file in ("model.h", wrapper)}
    own |= {f"sources/{name}.h": source.header, f"sources/{name}.c": source.source}
    config = _config(source, fmi, variables, tunables)
    token = _token(fmi, config, *own.values())
    own["sources/config.h"] = f'{config}#define TOKEN "{token}"\n\n#endif\n'
    own |= {f"sources/{file}": read_text("fmpy", _headers() / file) for file in HEADERS[fmi]}
    facts = FmuFacts(name, source.title, token, source.traced.law.period, (f"{name}.c", wrapper))
    if fmi == "2.0":
        return {"modelDescription.xml": description_2(facts, variables), **own}
    own["sources/buildDescription.xml"] = build_description(facts)
    return {"modelDescription.xml": description_3(facts, variables), **own}


def _config(source: CSource, fmi: str, variables: list[Variable], tunables: Sequence[Tunable]) -> str:
    """Return what ``model.h`` needs to know about the law."""
    upper, count = source.name.upper(), sum(len(tunable.values) for tunable in tunables)
    table = [f'VARIABLE({v.reference}, {v.count}, {v.member}, {v.kind}, {v.role}, "{v.name}")' for v in variables]
    arrays = {
        "parameter_starts": [value for tunable in tunables for value in tunable.values],
        "parameter_least": [value for tunable in tunables for value in tunable.least],
        "parameter_greatest": [value for tunable in tunables for value in tunable.greatest],
    }
    lines = [
        "/* What the model knows about the law. */",
        "#ifndef CONFIG_H",
        "#define CONFIG_H",
        "",
        *(PREFIX.format(source.name).splitlines() if fmi == "3.0" else ()),
        f'#include "{source.name}.h"',
        "",
        f"#define LAW(member) {source.name}_##member",
        f"#define LAW_OK {upper}_OK",
        f"#define LAW_NOT_READY {upper}_NOT_READY",
        f"#define JOINTS {upper}_JOINTS",
        f"#define PERIOD {upper}_PERIOD",
        f"#define PARAMETERS {count}",
        f"#define FIRST_PARAMETER {source.traced.n_states - count}",
        f"#define COMMANDS_POSITIONS {int(any(unit in POSITION_UNITS for unit in source.commands))}",
        "static const double start_limits[] = {"
        + ", ".join(repr(float(limit)) for limit in source.traced.start_limits)
        + "};",
    ]
    lines += [
        f"static const double {name}[PARAMETERS + 1] = {{{', '.join(map(repr, [*values, 0.0]))}}};"
        for name, values in arrays.items()
    ]
    lines.append("#define VARIABLE_TABLE \\")
    return "\n".join([*lines, *(f"  {row} \\" for row in table), "", ""])


def _token(*texts: str) -> str:
    """Return a GUID that the same texts give again."""
    code = hashlib.sha256("\0".join(texts).encode()).hexdigest()
    return f"{{{code[:8]}-{code[8:12]}-{code[12:16]}-{code[16:20]}-{code[20:32]}}}"


def _headers() -> Path:
    """Return the folder of the standard's headers in FMPy."""
    spec = find_spec("fmpy")
    assert spec is not None  # checked at the start
    assert spec.origin is not None
    return Path(spec.origin).parent / "c-code"


def _notice(fmi: str) -> str:
    """Return copyright and licence of the standard's headers, as they state them."""
    text = read_text("fmpy", _headers() / HEADERS[fmi][0])
    first = text.index("Copyright (C)")
    lines = (line.strip() for line in text[first : text.index("*/", first)].splitlines())
    return (
        "The headers fmi*.h in sources/ are those of the standard FMI, from FMPy's copy.\n\n" + "\n".join(lines) + "\n"
    )


def _page(source: CSource, variables: list[Variable], refused: Mapping[str, str]) -> str:
    """Return the documentation that the FMU has in it."""
    period = source.traced.law.period
    rows = "".join(
        f"<tr><td>{escape(variable.name)}</td><td>{variable.role.lower()}</td><td>{variable.size or ''}</td>"
        f"<td>{escape(variable.description)}</td></tr>\n"
        for variable in variables
    )
    fixed = "".join(f"<li>{escape(name)}: {escape(reason)}</li>\n" for name, reason in refused.items())
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(source.title)}</title></head><body>
<h1>{escape(source.title)}</h1>
<p>The law samples every {period!r} s. Set the communication step of a co-simulation to this period: it refuses
others. A torque of a co-simulation without event mode acts one period after its sample. In model exchange the law
samples by time events, and the torque acts at once. Co-simulation of FMI 3.0 in event mode does so too.</p>
<p>The first sample starts the law at rest, at the position measured then.</p>
<table><tr><th>variable</th><th>role</th><th>elements</th><th>meaning</th></tr>
{rows}</table>
<p>Numbers of the law that may not change while it runs, and why:</p>
<ul>
{fixed}</ul>
</body></html>
"""


def _compile(content: Mapping[str, str], name: str, fmi: str, platforms: tuple[str, ...] | None) -> dict[str, bytes]:
    """Return the shared libraries by their path in the FMU."""
    with tempfile.TemporaryDirectory() as folder:
        for path, text in content.items():
            if path.startswith("sources/"):
                (Path(folder) / Path(path).name).write_text(text, encoding="utf-8")
        return libraries(Path(folder), name, (f"{name}.c", WRAPPERS[fmi]), platforms, fmi)


def _check_replaceable(file: Path) -> None:
    """Refuse a file that `export_fmu` did not write, or that was changed since.

    Raises
    ------
    InvalidParameter
        For such a file.
    """
    if not file.exists():
        return
    try:
        with zipfile.ZipFile(file) as archive:
            is_ours = archive.comment == COMMENT + _content_hash(archive)
    except (OSError, zipfile.BadZipFile):
        is_ours = False
    if not is_ours:
        raise InvalidParameter(
            f"file: {file} was not written by this command, or was changed since; give another file, or move it away"
        )


def _content_hash(archive: zipfile.ZipFile) -> bytes:
    parts = "\n".join(f"{entry.filename} {entry.CRC:08x}" for entry in archive.infolist())
    return hashlib.sha256(parts.encode()).hexdigest().encode()


def _write(file: Path, content: Mapping[str, bytes]) -> None:
    make_folder("file", file.parent)
    with writing("file", file), zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(content):
            entry = zipfile.ZipInfo(path, TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content[path])
        archive.comment = COMMENT + _content_hash(archive)
