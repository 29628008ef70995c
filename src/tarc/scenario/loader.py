"""Find, read and change the YAML of a scenario."""

from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from tarc.core import validation as check
from tarc.core.errors import TarcError


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """The mapping, each key once."""
        keys = [key.value for key, _ in node.value]
        for key, _ in node.value:
            if keys.count(key.value) > 1:
                raise TarcError(f"line {key.start_mark.line + 1}: the key {key.value!r} is given twice; keep one")
        return super().construct_mapping(node, deep)


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    folder = files("tarc.scenario").joinpath("shipped")
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def find_scenario(path: str | Path) -> Path:
    """The file itself, or a shipped scenario by name."""
    here = Path(path).expanduser()
    if here.is_file():
        return here
    shipped = Path(str(files("tarc.scenario").joinpath("shipped"))) / f"{here.name.removesuffix('.yaml')}.yaml"
    if len(here.parts) == 1 and shipped.is_file():
        return shipped
    names = shipped_scenarios()
    raise TarcError(
        f"scenario: {str(path)!r} not found; looked for {here.resolve()} and among the shipped scenarios "
        f"({', '.join(names)}).{check.did_you_mean(here.stem, names)}"
    )


def apply_setting(content: dict[str, Any], setting: str) -> None:
    """Put ``section.key=value`` into a scenario's dictionary; ``law.key`` reaches every law of a list."""
    path, equals, text = setting.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys):
        raise TarcError(f"--set: got {setting!r}; needs key=value, such as law.natural_frequency=15")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise TarcError(f"--set: {text!r} is no YAML value, in {setting!r}") from None
    nodes: list[Any] = [content]
    for depth, key in enumerate(keys[:-1]):
        found: list[Any] = []
        for node in nodes:
            if isinstance(node, list):
                if not key.isdigit() or int(key) >= len(node):
                    raise TarcError(
                        f"--set: {setting!r}: {'.'.join(keys[:depth])} is a list of {len(node)}; use 0, 1, …"
                    )
                child = node[int(key)]
            elif isinstance(node, dict):
                child = node.setdefault(key, {})
            else:
                raise TarcError(f"--set: {setting!r}: {'.'.join(keys[:depth])} is {node!r}, which holds no keys")
            spread = isinstance(child, list) and not keys[depth + 1].isdigit()
            found += child if spread else [child]
        nodes = found
    for node in nodes:
        if isinstance(node, list) and keys[-1].isdigit() and int(keys[-1]) < len(node):
            node[int(keys[-1])] = value
        elif isinstance(node, dict):
            node[keys[-1]] = value
        else:
            raise TarcError(f"--set: {setting!r} reaches {node!r}, which holds no key {keys[-1]!r}")
