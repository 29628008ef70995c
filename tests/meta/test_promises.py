"""What the project promises of itself."""

import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import tarc

ROOT = Path(__file__).parents[2]
PACKAGES = [
    "tarc",
    *(
        f"tarc.{part}"
        for part in (
            "laws",
            "estimators",
            "plants",
            "signals",
            "analysis",
            "certificates",
            "paper",
            "design",
            "export",
            "runtime",
            "study",
        )
    ),
]


def public_objects():
    modules = [importlib.import_module(package) for package in PACKAGES]
    return [(f"{module.__name__}.{name}", getattr(module, name)) for module in modules for name in module.__all__]


@pytest.mark.parametrize(("name", "thing"), public_objects(), ids=lambda x: x if isinstance(x, str) else "")
def test_public_names_are_documented(name, thing):
    if name.endswith("__version__"):
        return
    assert inspect.getdoc(thing), name
    if inspect.isclass(thing):
        members = [member for key, member in vars(thing).items() if not key.startswith("_") and callable(member)]
        assert all(inspect.getdoc(member) for member in members), name


@pytest.mark.parametrize(("name", "thing"), public_objects(), ids=lambda x: x if isinstance(x, str) else "")
def test_public_names_are_in_the_reference(name, thing):
    folders = (ROOT / "docs" / "reference", ROOT / "docs" / "laws")
    pages = "\n".join(page.read_text() for folder in folders for page in folder.glob("*.md"))
    short = name.rpartition(".")[2]
    assert short in pages or f"::: {name.rpartition('.')[0]}\n" in pages, (
        f"{name} is on no page of docs/reference or docs/laws"
    )


def test_import_is_light():
    """Importing the package, and the command line, loads no heavy library."""
    heavy = {"numpy", "scipy", "casadi", "mujoco", "xarray", "matplotlib", "pydantic"}
    for module in ("tarc", "tarc.cli.main"):
        code = f"import sys, {module}; print(*sys.modules)"
        loaded = set(
            subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
        )
        assert not heavy & loaded, module


LONG_EXAMPLES = {
    "change_gains",
    "affine_certificate",
    "certify_robot",
    "compare_laws",
    "design_robot",
    "fmu_loop",
    "how_sure",
    "largest_error",
    "literal_or_synchronised",
    "live_loop",
    "my_law",
    "replay_log",
    "study_of_loads",
    "tune_front",
}


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(path, id=path.stem, marks=pytest.mark.slow if path.stem in LONG_EXAMPLES else ())
        for path in sorted((ROOT / "examples").glob("*.py"))
    ],
)
def test_examples_run(example, tmp_path):
    process = subprocess.run(
        [sys.executable, "-W", "error", str(example)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.yaml")), ids=lambda path: path.stem)
def test_example_scenarios_complete(example):
    runs = tarc.Scenario.load(example).run()
    assert all(run.status.completed for run in runs.values())


def test_symbols_exist():
    """Each code word of the table of symbols is a parameter, field or attribute of something public, or what a
    certificate carries.
    """
    page = (ROOT / "docs" / "explanation" / "symbols.md").read_text()
    table = [line.split("|") for line in page.splitlines() if line.startswith("| ")]
    words = {word.strip("` ") for row in table for word in row[2].split(",") if "`" in word}
    assert len(words) > 15
    names = set()
    for _, thing in public_objects():
        if inspect.isclass(thing):
            names |= set(dir(thing)) | set(getattr(thing, "__dataclass_fields__", {}))
        elif callable(thing):
            names |= set(inspect.signature(thing).parameters)
    from tarc.certificates.region_evidence import RegionEvidence
    from tarc.laws.base import ControlInput
    from tarc.simulation.quantities import VARIABLES

    names |= set(VARIABLES) | set(ControlInput._fields)
    law = tarc.laws.TDC(
        inertia=0.5,
        natural_frequency=10.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.01),
        synchronised=True,
    )
    space = tarc.analysis.Workspace.box([-0.3], [0.3], speed=1.0)
    for certificate in (
        tarc.certificates.certify_varying_ratio(law, rate=5.0),
        tarc.certificates.certify_robot(law, tarc.plants.Pendulum(), space),
    ):
        names |= names_of_fields(certificate.to_dict())
    names |= set(dir(RegionEvidence))  # what the region of attraction rests on
    assert words <= names, words - names


def names_of_fields(content: Any) -> set[str]:
    """Return all keys of nested dictionaries."""
    if isinstance(content, dict):
        return set(content).union(*(names_of_fields(entry) for entry in content.values()))
    return set()


@pytest.mark.slow
def test_docs_build_strictly(tmp_path):
    process = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert "network" not in process.stderr
