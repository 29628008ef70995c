"""Rules that the source keeps: layers, imports at the top, short functions, annotations that say a type."""

import subprocess
import sys
from pathlib import Path

from source_facts import (
    ROOT,
    annotations,
    caught_classes,
    functions,
    imports_inside_functions,
    is_bare_any,
    n_lines,
    raised_classes,
)

PLOT_METHODS = {
    ("tarc.certificates.base", "tarc.plotting.certificates"),
    ("tarc.design.result", "tarc.plotting.design"),
    ("tarc.estimators.base", "tarc.plotting.estimators"),
    ("tarc.logs.diagnosis", "tarc.plotting.diagnosis"),
    ("tarc.logs.replayed", "tarc.plotting.replay"),
    ("tarc.simulation.run", "tarc.plotting.animation"),
    ("tarc.simulation.run", "tarc.plotting.runs"),
    ("tarc.simulation.run", "tarc.plotting.viewer"),
    ("tarc.study.comparison", "tarc.plotting.comparison"),
    ("tarc.study.report", "tarc.plotting.study"),
    ("tarc.study.report_measures", "tarc.plotting.study"),
    ("tarc.study.report_searches", "tarc.plotting.study"),
}
"""Imports that run upward; the contract in pyproject.toml lists the same."""

NEEDS_EXTRA = {
    ("tarc.scenario.cartesian", "tarc.scenario.inverse_kinematics"),
    ("tarc.plants.gearbox", "tarc.plants.mujoco_gearbox"),
    ("tarc.laws.model_based", "tarc.plants.mujoco"),  # MuJoCo comes with an extra; laws without a model need none
}
NEEDS_NUMPY = {
    # the command line makes its options from this module's class, and `--help` waits for no numerical library
    ("tarc.design.requirements", "tarc.core.validation"),
    ("tarc.design.requirements", "tarc.signals.sensors"),
}
NEEDS_OPTUNA = {
    ("tarc.study.law_search", f"tarc.study.{module}")
    for module in ("optuna_search", "search_sampler", "search_storage")
}
NEEDS_XARRAY = {
    ("tarc.scenario.model", "tarc.simulation.simulator"),  # what certifies and simulates nothing needs no xarray
}
STARTS_WITHOUT = {
    # the page is up before the libraries that compute are there
    ("tarc.studio.robots", "tarc.scenario.loader"),
    ("tarc.studio.robots", "tarc.scenario.model"),
}
INSIDE_FUNCTIONS = STARTS_WITHOUT | PLOT_METHODS | NEEDS_EXTRA | NEEDS_NUMPY | NEEDS_OPTUNA | NEEDS_XARRAY
"""Imports of the package inside functions outside `tarc.cli`, which has them so that ``--help`` is fast."""

BLANKET_HANDLERS = {
    ("tarc.cli.main", "TarcError"),  # prints the message
    ("tarc.laws.base", "Exception"),  # of a function that the user gives
    ("tarc.scenario.user_law", "Exception"),  # of a file that the user gives
}

MAX_SHARE_OF_ANY = 0.01
MAX_LINES = 60


def test_layers_import_downward():
    # in a process of its own, since it switches all loggers off
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_imports_inside_functions_are_listed():
    """Else they belong at the top of their modules."""
    inside = {pair for pair in imports_inside_functions() if not pair[0].startswith("tarc.cli")}
    assert inside == INSIDE_FUNCTIONS


def test_errors_are_raised_by_their_precise_class():
    raised = set(raised_classes())
    assert not {module for module, kind in raised if kind in ("TarcError", "Exception", "RuntimeError")}


def test_handlers_catch_precise_classes():
    blanket = {pair for pair in caught_classes() if pair[1] in ("", "BaseException", "Exception", "TarcError")}
    assert blanket == BLANKET_HANDLERS


def test_few_annotations_are_any():
    bare = [is_bare_any(annotation) for annotation in annotations()]
    assert sum(bare) <= MAX_SHARE_OF_ANY * len(bare), f"{sum(bare)} of {len(bare)} annotations are Any"


def test_functions_are_short():
    """Lines of code; the docstring is not counted."""
    long = {f"{module}.{function.name}": n_lines(function) for module, function in functions()}
    long = {name: lines for name, lines in long.items() if lines > MAX_LINES}
    assert not long


def test_formatter_is_not_switched_off():
    places = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in sorted((ROOT / "src").rglob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if "fmt: skip" in line or "fmt: off" in line
    ]
    assert not places


def test_benchmarks_are_imported_by_their_own_tests_alone():
    importing = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "tests").rglob("*.py")
        if "import benchmarks" in (text := path.read_text(encoding="utf-8")) or "from benchmarks" in text
    }
    of_benchmarks = {name for name in importing if name.startswith("tests/benchmarks/")}
    assert importing - of_benchmarks == {"tests/meta/test_source.py"}
