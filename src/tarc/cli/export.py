"""`tarc export` and `tarc verify-export`: laws as C, and the proof that it is the same law."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tarc.cli.export_fmu import export_fmu_file
from tarc.cli.options import FullRange, Json, ScenarioName, Set, Speed, Tube, numbers_of
from tarc.core.errors import InvalidParameter

if TYPE_CHECKING:
    from tarc.export import Export, ExportReport

FORMATS = ("c", "fmu", "ros2")

Format = Annotated[
    str,
    typer.Argument(
        metavar="FORMAT",
        help="c: C99 with recorded steps and build files. fmu: a Functional Mock-up Unit. ros2: a colcon package with "
        "a controller and a node.",
    ),
]
Folder = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder to write, or the file of an FMU. Default: build/ and the scenario."),
]
LawName = Annotated[
    str,
    typer.Option(
        "--law",
        metavar="NAME",
        help="Law of the scenario, or FILE.py:CLASS as for tarc run. Default: the first.",
    ),
]
CName = Annotated[str, typer.Option("--name", help="Prefix of the names in C. Default: the folder's name.")]
Real = Annotated[str, typer.Option(help="double or float.")]
Firmware = Annotated[bool, typer.Option("--firmware", help="Also a program for Cortex-M3, M4F and M7 in QEMU.")]
Watched = Annotated[
    bool,
    typer.Option(
        "--watch",
        help="Flags in the output where position, speed, load or sample timing leave what tarc certify assumes. "
        "--tube, --full-range and --speed say what that is.",
    ),
]
Parts = Annotated[
    bool, typer.Option("--parts", help="Also the estimator, the reference and, of a model, M̂(q), each as a C function.")
]
Fmi = Annotated[str, typer.Option("--fmi", help="Version of an FMU: 2.0, or 3.0 with arrays.")]
Platforms = Annotated[
    str,
    typer.Option(
        "--platforms",
        help="Platforms of an FMU with commas: x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin, "
        "aarch64-darwin; all; or none for the sources alone. Default: this machine's.",
    ),
]
Tunable = Annotated[
    str,
    typer.Option("--tunable", help="Parameters of an FMU that may change as it runs, or none. Default: all that can."),
]
Realtime = Annotated[
    bool,
    typer.Option("--realtime", help="Also a program for Linux that runs the law on a robot over UDP; implies --parts."),
]
ExportFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="What tarc export c wrote.")]
Compiler = Annotated[str, typer.Option("--cc", help="C compiler with options. Default: the one that is found.")]
Steps = Annotated[int, typer.Option(help="Random steps to compare with the law.")]


def export(
    kind: Format,
    scenario: ScenarioName,
    out: Folder = None,
    law: LawName = "",
    name: CName = "",
    real: Real = "double",
    firmware: Firmware = False,
    parts: Parts = False,
    realtime: Realtime = False,
    watch: Watched = False,
    tube: Tube = 0.01,
    full_range: FullRange = False,
    speed: Speed = "",
    fmi: Fmi = "2.0",
    platforms: Platforms = "",
    tunable: Tunable = "",
    set_: Set = None,
    as_json: Json = False,
) -> None:
    """Write a scenario's law for its machine: exactly the step that was simulated and certified.

    The folder has the C, recorded steps with their expected bits, and build
    files for CMake, PlatformIO, Arduino and Zephyr. Its law.yaml has all
    parameters, the scenario, and the verdict of a design's certificates. Files
    that this command did not write are never touched.

    Example: tarc export c ur5e --law TARC -o build/arm

    Example: tarc export fmu ur5e --law TARC -o build/arm.fmu

    Example: tarc export ros2 ur5e --law TARC -o build/arm_controller --name arm
    """
    from tarc.export import export_c, export_ros2
    from tarc.scenario.deployment import law_of
    from tarc.scenario.loader import relative_files
    from tarc.scenario.model import Scenario
    from tarc.scenario.user_law import is_user_law

    _check_format(kind, firmware, realtime, real, watch, parts)
    is_own = is_user_law(law)
    loaded = Scenario.load(scenario, set_ or [], law=law if is_own else "")
    chosen, built, limits, joints = law_of(loaded, "" if is_own else law)
    folder = out or Path("build") / f"{Path(scenario).stem}{'.fmu' if kind == 'fmu' else ''}"
    certificate = stored_certificate(Path(scenario), chosen)
    content = loaded.model_dump(mode="json", exclude_defaults=True)
    relative_files(content, folder.parent if kind == "fmu" else folder)
    options: dict[str, Any] = {
        "name": name or None,
        "torque_limits": limits,
        "joint_names": joints,
        "certificate": certificate,
        "scenario": {"law": chosen, "content": content},
    }
    units = loaded.build_plant().torque_units
    if kind == "fmu":
        export_fmu_file(built, folder, as_json, fmi, platforms, tunable, commands=units, **options)
        return
    options["real"] = real
    if watch:
        numbers = numbers_of("--speed", speed)
        options["watch"] = loaded.watch(chosen, tube=tube, full_range=full_range, speed=numbers)
    if kind == "ros2":
        check_efforts(units)
        written = export_ros2(built, folder, **options)
    else:
        parts = parts or realtime
        options |= {"firmware": firmware, "parts": parts, "reference": loaded.build().reference if parts else None}
        options["realtime"] = realtime
        written = export_c(built, folder, commands=units, **options)
    _print_written(written, chosen, certificate is not None, as_json)


def _check_format(kind: str, firmware: bool, realtime: bool, real: str, watch: bool, parts: bool) -> None:
    """Refuse another format, and options that a format does not have."""
    from tarc.core import validation as check

    check.one_of("FORMAT", kind, FORMATS)
    if (firmware or realtime) and kind != "c":
        raise InvalidParameter(f"--{'firmware' if firmware else 'realtime'}: only with the format c")
    if kind == "fmu" and (real != "double" or watch or parts):
        raise InvalidParameter("--real, --watch, --parts: not with the format fmu, which has doubles, without flags")


def check_efforts(units: Sequence[str]) -> None:
    """Refuse a law whose commands are no efforts."""
    if any(unit not in ("N m", "N") for unit in units):
        raise InvalidParameter(f"ros2: the law commands {', '.join(units)}, and the controller speaks efforts alone")


def verify_export(folder: ExportFolder, cc: Compiler = "", steps: Steps = 100_000, as_json: Json = False) -> None:
    """Compile exported C, replay its recorded steps, and compare random steps with the law, bit by bit.

    The law is built again from the scenario in law.yaml; files of yours that
    it names are sought from FOLDER. Exit status 1 where the C is not the law,
    or a compiler warns.

    Example: tarc verify-export build/arm --cc "gcc -O1"
    """
    from tarc.export import verify_export as verify
    from tarc.export.verification import read_law_yaml
    from tarc.scenario.deployment import law_of
    from tarc.scenario.loader import resolve_files
    from tarc.scenario.model import Scenario

    scenario = read_law_yaml(folder).get("scenario")
    law = limits = None
    if scenario is not None:
        resolve_files(scenario["content"], folder)
        _, law, limits, _ = law_of(Scenario.parse(scenario["content"]), scenario["law"])
    report = verify(folder, law=law, torque_limits=limits, command=shlex.split(cc) or None, steps=steps)
    if as_json:
        print(json.dumps(asdict(report) | {"passed": report.passed}, indent=2))
    else:
        _print_report(report)
    if not report.passed:
        raise typer.Exit(1)


def stored_certificate(scenario: Path, law: str) -> dict[str, Any] | None:
    """Return verdict and assumptions from the certificates that a design or `tarc certify` left, if any.

    A certificate of `tarc certify` that is older than the scenario's file, or than a Python file beside it, is stale.
    """
    stem = scenario.stem
    certified = Path("runs") / stem / f"{law}-certificates.json"
    sources = [scenario, *scenario.parent.glob("*.py")] if scenario.is_file() else []
    for file in (scenario.with_name(f"{stem}-certificates.json"), certified):
        try:
            if file == certified and any(file.stat().st_mtime < source.stat().st_mtime for source in sources):
                continue
            certificate = json.loads(file.read_text(encoding="utf-8"))["robot"]
            keys = ("verdict", "margin", "claim", "assumptions")
            return {**{key: certificate[key] for key in keys}, "file": file.name}
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return None


def _print_written(written: "Export", law: str, is_judged: bool, as_json: bool) -> None:
    from rich.console import Console

    if as_json:
        print(json.dumps({"folder": str(written.folder), "files": [str(file) for file in written.files]}, indent=2))
        return
    console = Console(width=None if Console().is_terminal else 100)
    console.print(f"{law} as C99 in {written.folder}, numbers are {written.real}:", highlight=False)
    for file in written.files:
        console.print(f"  {file.relative_to(written.folder)}", highlight=False)
    if not is_judged:
        console.print(
            "no certificate of this scenario was found, law.yaml says so: tarc certify, then export again",
            highlight=False,
        )
    console.print(f"now: tarc verify-export {written.folder}", highlight=False)
    if (makefile := written.folder / "firmware" / "Makefile") in written.files:
        console.print(f"and: make -C {makefile.parent} run", highlight=False)


def _print_report(report: "ExportReport") -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if Console().is_terminal else 100)
    table = Table("test", "result", title=f"{report.name}, {report.real}", title_justify="left")
    table.add_row("header and source have their hash", "yes" if report.is_unchanged else "[red]no[/red]")
    if report.is_same_law is not None:
        table.add_row("the law gives the same C", "yes" if report.is_same_law else "[red]no[/red]")
    for replay in report.replays:
        text = f"{replay.different} of {replay.total} numbers differ, {1e9 * replay.step_time:.0f} ns per step"
        if not replay.passed:
            text = f"[red]{text}[/red]"
        table.add_row(f"recorded steps, {replay.command}", text + (", with warnings" if replay.warnings else ""))
    if report.comparison is not None:
        comparison = report.comparison
        text = f"{comparison.different} numbers differ, by {comparison.largest:.1e} at most; "
        text += f"{comparison.decisions} decisions differ"
        table.add_row(f"{comparison.steps} random steps against the law", text)
        if report.real == "float":
            table.add_row("torque against double precision", f"{comparison.torque_difference:.2g} N m or N at most")
    if report.parts is not None:
        table.add_row("parts", report.parts if report.parts_passed else f"[red]{report.parts}[/red]")
    if report.code_size is not None:
        table.add_row("machine code", f"{report.code_size} bytes")
    if report.stack is not None:
        table.add_row("stack of a step", f"{report.stack} bytes")
    console.print(table)
    for replay in report.replays:
        if replay.warnings:
            console.print(replay.warnings, style="yellow", markup=False, highlight=False)
    console.print("the C is the law" if report.passed else "the C is NOT shown to be the law", highlight=False)
