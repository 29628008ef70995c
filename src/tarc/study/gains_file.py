"""Files of gains, as `tarc tune` writes them."""

from pathlib import Path
from typing import Any

from tarc.core.errors import ScenarioError
from tarc.scenario.loader import relative_files, resolve_files
from tarc.scenario.yaml_text import read_yaml


def load_gains(path: str | Path) -> dict[str, dict[str, Any]]:
    """Return the laws of a file that `tarc tune` wrote, by name, as a scenario writes them.

    Parameters
    ----------
    path
        The file. A law from a user's own file, ``my_file.MyLaw``, is sought beside it.

    Raises
    ------
    ScenarioError
        For a file that cannot be read, and one without laws.
    """
    file = Path(path).expanduser()
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"gains: {file} cannot be read: {error}; needs a file that tarc tune wrote") from None
    content = read_yaml(text, str(file))
    laws = content.get("laws") if isinstance(content, dict) else None
    if not isinstance(laws, dict) or not laws:
        raise ScenarioError(f"gains: {file} has no laws; needs one of tarc tune, with laws: NAME: {{kind: …}}")
    for name, law in laws.items():
        if not isinstance(law, dict) or "kind" not in law:
            raise ScenarioError(f"gains: {file}: laws.{name}.kind: missing; got {law!r}", f"laws.{name}.kind")
        resolve_files({"law": law}, file.parent)
    return {str(name): law for name, law in laws.items()}


def relative_laws(laws: dict[str, dict[str, Any]], folder: Path) -> dict[str, dict[str, Any]]:
    """Return laws with the files of a user's own laws named from a folder."""
    copies = {name: dict(law) for name, law in laws.items()}
    for law in copies.values():
        relative_files({"law": law}, folder)
    return copies
