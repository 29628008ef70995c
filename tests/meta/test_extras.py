"""Extras of the package: what they install, and what is said where a library is missing."""

import re
import sys
import tomllib
from collections.abc import Mapping
from importlib.machinery import ModuleSpec
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tarc.core import optional
from tarc.core.errors import MissingTool, TarcError

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]


def distributions(extra: str) -> set[str]:
    """Return the distributions of an extra, those of the extras that it names included."""
    names = set()
    for requirement in EXTRAS[extra]:
        parts = re.match(r"([\w.-]+)(?:\[([\w,-]+)\])?", requirement)
        assert parts, requirement
        name, inner = parts.groups()
        own = inner.split(",") if name == "tarc-control" else []
        names |= set.union(*(distributions(part) for part in own)) if own else {name}
    return names


@pytest.fixture(scope="module")
def owners() -> Mapping[str, list[str]]:
    """Return the installed distributions of each module."""
    return packages_distributions()


@pytest.mark.parametrize("extra", optional.EXTRAS)
def test_an_extra_is_checked_by_the_modules_that_it_installs(extra: str, owners: Mapping[str, list[str]]) -> None:
    installed = {owners[module.partition(".")[0]][0].lower().removesuffix("-core") for module in optional.EXTRAS[extra]}
    assert installed == distributions(extra)


def test_all_has_every_other_extra() -> None:
    assert distributions("all") == set.union(*(distributions(extra) for extra in EXTRAS if extra != "all"))


def test_a_missing_module_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def find(name: str) -> ModuleSpec | None:
        return None if name in ("mujoco", "xarray") else ModuleSpec(name, None)

    monkeypatch.setattr(optional, "find_spec", find)
    for name in ("mujoco", "xarray"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(
        MissingTool, match=rf"^a run needs mujoco, xarray; pip install -e '{re.escape(str(ROOT))}\[sim\]'$"
    ):
        optional.require("sim", "a run")
    optional.require("sim", "a run", "h5py")


def test_a_missing_tool_is_an_import_error_and_one_of_the_package() -> None:
    assert issubclass(MissingTool, ImportError)
    assert issubclass(MissingTool, TarcError)


@pytest.mark.parametrize(
    ("module", "answer"), [("numpy", True), ("json.tool", True), ("nosuch", False), ("nosuch.part", False)]
)
def test_a_module_is_found_without_being_imported(module: str, answer: bool) -> None:
    assert optional.is_installed(module) is answer
