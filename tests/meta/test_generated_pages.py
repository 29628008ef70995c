"""Pages that are written from the code name all that there is."""

import importlib.util
from pathlib import Path

import pytest
import typer

from tarc.cli.main import app
from tarc.scenario.model import Scenario
from tarc.scenario.schema import SECTIONS, catalogue, parameters

ROOT = Path(__file__).parents[2]


def hook(name):
    specification = importlib.util.spec_from_file_location(name, ROOT / "docs" / "hooks" / f"{name}.py")
    assert specification
    assert specification.loader
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_command_line_page_has_every_option():
    commands = hook("command_line")
    page = commands.page()
    for name, command in commands.commands(typer.main.get_command(app)):
        section = page.split(f"\n## tarc {name}\n")[1].split("\n## ")[0]
        for parameter in command.params:
            spellings = parameter.opts if parameter.param_type_name == "option" else [parameter.name.upper()]
            assert all(f"`{word}" in section or f"[{word}" in section for word in spellings), (name, parameter.name)
            assert parameter.help, (name, parameter.name)


@pytest.mark.parametrize("section", SECTIONS)
def test_scenario_page_has_every_key(section):
    page = hook("scenario_keys").page()
    part = page.split(f"\n## {section}\n")[1].split("\n## ")[0]
    for name, kind in catalogue(section).items():
        entry = part.split(f"\n### {name}\n")[1].split("\n### ")[0]
        shared = part.split("\n### Keys of every law\n")[1].split("\n### ")[0] if section == "law" else ""
        missing = [key for key in parameters(kind) if f"| `{key}` |" not in entry + shared]
        assert not missing, name


def test_scenario_page_has_the_keys_of_a_scenario():
    page = hook("scenario_keys").page()
    assert all(f"| `{key}` |" in page for key in Scenario.model_fields)


def test_gallery_has_every_example():
    page = hook("gallery").page()
    examples = [*(ROOT / "examples").glob("*.py"), *(ROOT / "examples").glob("*.yaml")]
    assert len(examples) > 5
    for example in examples:
        assert f"](../images/examples/{example.stem}.png)" in page
        assert f'"examples/{example.name}"' in page
