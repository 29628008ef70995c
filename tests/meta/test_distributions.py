"""Wheel and source distribution, built and installed into empty environments."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORE = {"casadi", "numpy", "scipy"}
LEFTOVERS = re.compile(r"(__pycache__|\.pyc|\.so|\.nc|\.egg-info|\.venv|_cache|\.hypothesis)(/|$)|^(site|runs|dist)/")
ENVIRONMENT = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}

pytestmark = pytest.mark.slow


def run(*command: str | Path, cwd: Path, status: int = 0) -> str:
    """Run a command with the environment's variables but the Python path; return what it prints."""
    process = subprocess.run(command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert process.returncode == status, f"{command}: {process.stdout[-2000:]}{process.stderr[-2000:]}"
    return process.stdout + process.stderr


@dataclass(frozen=True)
class Built:
    """Source distribution, its unpacked folder, and the wheel that is built from that."""

    archive: Path
    source: Path
    wheel: Path


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    folder = tmp_path_factory.mktemp("dist")
    build = (sys.executable, "-m", "hatchling", "build", "-d", folder)
    run(*build, "-t", "sdist", cwd=ROOT)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as content:
        if sys.version_info >= (3, 11, 4):
            content.extractall(folder, filter="data")
        else:
            content.extractall(folder)
    source = folder / archive.name.removesuffix(".tar.gz")
    run(*build, "-t", "wheel", cwd=source)
    (wheel,) = folder.glob("*.whl")
    return Built(archive, source, wheel)


@dataclass(frozen=True)
class Installed:
    """An environment that holds the wheel with one extra."""

    folder: Path

    def command(self, name: str) -> Path:
        """Return the path of a command of the environment."""
        return self.folder / ("Scripts" if os.name == "nt" else "bin") / name

    def python(self, code: str) -> str:
        """Run code in a folder of its own; return what it prints."""
        return run(self.command("python"), "-W", "error", "-c", code, cwd=self.folder)


@pytest.fixture
def install(built: Built, tmp_path: Path) -> Iterator[Callable[[str], Installed]]:
    """Install the wheel with an extra, in the versions of the lock file."""
    lock = (ROOT / "requirements-dev.lock").read_text(encoding="utf-8")
    pins = tmp_path / "pins.txt"
    pins.write_text("\n".join(re.findall(r"^[a-z].*?(?= \\$)", lock, re.MULTILINE)), encoding="utf-8")
    installed = Installed(tmp_path / "environment")
    uv = Path(sys.executable).with_name("uv")

    def do(extra: str = "") -> Installed:
        run(uv, "venv", "--quiet", "--python", sys.executable, installed.folder, cwd=tmp_path)
        target = ("--python", installed.command("python"), "--constraint", pins)
        run(uv, "pip", "install", "--quiet", *target, f"{built.wheel}{extra}", cwd=tmp_path)
        return installed

    yield do
    shutil.rmtree(installed.folder, ignore_errors=True)


def test_the_source_distribution_has_the_tests_and_nothing_that_was_left_by_a_build(built: Built) -> None:
    names = {path.relative_to(built.source).as_posix() for path in built.source.rglob("*") if path.is_file()}
    assert not [name for name in names if LEFTOVERS.search(name)]
    if not (ROOT / ".git").exists():
        return
    tracked = set(run("git", "ls-files", "-z", "--", ".", ":!.*", cwd=ROOT).split("\0")) - {""}
    assert tracked - names == set()


def test_tests_run_from_the_source_distribution(built: Built) -> None:
    path = {**ENVIRONMENT, "PYTHONPATH": str(built.source / "src")}
    for arguments in (("--collect-only",), ("tests/meta/test_extras.py", "tests/signals")):
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
        process = subprocess.run(command, cwd=built.source, env=path, capture_output=True, text=True, check=False)
        assert process.returncode == 0, process.stdout[-2000:]


def test_the_wheel_has_its_data_and_nothing_else(built: Built) -> None:
    names = zipfile.ZipFile(built.wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "tarc",
        built.wheel.name.removesuffix("-py3-none-any.whl") + ".dist-info",
    }
    assert not [name for name in names if LEFTOVERS.search(name)]
    assert {"tarc/py.typed", "tarc/study/gains.yaml", "tarc/plants/robots/ur5e.xml"} <= set(names)
    for folder in ("scenario/shipped", "plants/robots"):
        shipped = {
            f"tarc/{folder}/{path.name}" for path in (ROOT / "src" / "tarc" / folder).iterdir() if path.is_file()
        }
        assert shipped <= set(names)


CONTROLLER = """
import numpy as np
import tarc

arm = tarc.plants.TwoLinkArm()
estimator = tarc.estimators.Algebraic(window=0.010, degree=2)
adaptive = tarc.laws.TARC(
    inertia=[[0.15, 0.05], [0.05, 0.05]], natural_frequency=10.0, period=1e-3, estimator=estimator,
    rise_rate=2000.0, fall_rate=1000.0,
)
modelled = tarc.laws.ComputedTorque(model=arm, natural_frequency=10.0, period=1e-3, estimator=estimator)
reference = tarc.signals.Sinusoid(amplitude=[0.6, 0.6], frequency=[2.0, 2.5])
for law in (adaptive, modelled):
    controller = tarc.Controller(law)
    controller.reset([0.1, -0.2])
    assert np.all(np.isfinite(controller.step([0.1, -0.2], [0.1, -0.19], [0.0, 0.0], [0.0, 0.0])))
"""


def test_the_core_controls_a_robot_and_all_else_names_its_extra(install: Callable[[], Installed]) -> None:
    lean = install()
    listed = lean.python("import importlib.metadata as m, json; print(json.dumps([d.name for d in m.distributions()]))")
    assert set(json.loads(listed)) - {"pip", "setuptools"} == CORE | {"tarc-control"}
    lean.python(CONTROLLER)
    code = "import tarc\nfrom tarc.core.errors import MissingTool\ntry: {}\nexcept MissingTool as error: print(error)"
    for statement, extra in {
        "tarc.simulate": "sim",
        "tarc.Run": "sim",
        "tarc.Scenario": "cli",
        "tarc.CartesianWaypoints": "cli",
        "tarc.certify_law": "certify",
        "tarc.certificates.Certificate": "certify",
        "tarc.paper.check_theorem2": "certify",
        "tarc.design.design_controller": "cli",
        "tarc.study.tune": "cli",
        "tarc.plants.MujocoPlant": "robots",
        "tarc.plants.find_robot": "robots",
        "import tarc.plotting.runs": "plot",
        "tarc.estimators.Algebraic(window=0.01, degree=2).with_period(1e-3).plot()": "plot",
    }.items():
        assert lean.python(code.format(statement)).endswith(f"; pip install 'tarc-control[{extra}]'\n"), statement
    said = run(lean.command("tarc"), cwd=lean.folder, status=2)
    assert said.startswith("error: the command tarc needs ")
    assert said.endswith("; pip install 'tarc-control[cli]'\n")


@pytest.mark.parametrize(
    ("extra", "code"),
    [
        ("[robots]", "import tarc; assert tarc.plants.MujocoPlant.from_file('ur5e').n_joints == 6"),
        ("[sim]", "run = tarc.simulate(arm, adaptive, reference, 1.0); run.save('run.nc'); tarc.Run.load('run.nc')"),
        (
            "[certify]",
            "assert tarc.certificates.certify_constant_ratio(adaptive).verdict; import tarc.paper, tarc.certification",
        ),
        (
            "[ik]",
            "ur5e = tarc.plants.load_robot('ur5e'); points = [[-0.49, -0.13, 0.49], [-0.4, 0.0, 0.4]]; "
            "tarc.CartesianWaypoints(robot=ur5e, frame='tool', points=points, times=[0.0, 1.0])",
        ),
        ("[plot]", "estimator.with_period(1e-3).plot().savefig('estimator.png')"),
    ],
)
def test_an_extra_has_all_that_its_part_needs(install: Callable[[str], Installed], extra: str, code: str) -> None:
    install(extra).python(CONTROLLER + code)


def test_the_command_runs_with_its_extra(install: Callable[[str], Installed]) -> None:
    installed = install("[cli]")
    tarc = installed.command("tarc")
    run(tarc, "run", "two_link_friction", "--set", "duration=1", "--out", "out", cwd=installed.folder)
    assert {path.suffix for path in (installed.folder / "out").iterdir()} == {".yaml", ".nc", ".png", ".pdf"}
    said = run(tarc, "tune", "train_two_link", "--trials", "1", cwd=installed.folder, status=2)
    assert said.strip().endswith("tune needs cmaes, optuna; pip install 'tarc-control[study]'")


def test_all_runs_a_shipped_scenario(install: Callable[[str], Installed]) -> None:
    installed = install("[all]")
    tarc = installed.command("tarc")
    run(tarc, "run", "ur5e", "--set", "duration=1", "--out", "out", cwd=installed.folder)
    assert (installed.folder / "out" / "tracking.png").is_file()
    run(tarc, "tune", "train_two_link", "--laws", "pid", "--trials", "1", "--jobs", "1", cwd=installed.folder)
    run(installed.command("python"), "-m", "ziglang", "version", cwd=installed.folder)
