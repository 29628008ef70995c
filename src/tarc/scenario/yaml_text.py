"""Read and write YAML."""

from io import StringIO
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import YAMLError

from tarc.core.errors import ScenarioError


def read_yaml(text: str, label: str) -> Any:
    """Return the content of a YAML text as dictionaries, lists, numbers and texts.

    Parameters
    ----------
    text
        YAML 1.2.
    label
        Name of the source, for the message.

    Raises
    ------
    ScenarioError
        For text that is not YAML, and for a key that is given twice.
    """
    try:
        return YAML(typ="safe", pure=True).load(text)
    except DuplicateKeyError as error:
        line = 0 if error.problem_mark is None else error.problem_mark.line + 1
        raise ScenarioError(f"{label}: line {line}: {_first_clause(error)}; keep one of them") from None
    except YAMLError as error:
        raise ScenarioError(f"{label}: no valid YAML: {error}") from None


def write_yaml(content: object, width: int = 120) -> str:
    """Return plain data as YAML, in the order of its keys; lists of numbers stand on one line.

    Parameters
    ----------
    content
        Dictionaries, lists, numbers and texts.
    width
        Largest number of characters per line.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.default_flow_style = None  # type: ignore[assignment]
    yaml.width = width  # type: ignore[assignment]
    yaml.allow_unicode = True
    stream = StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()


def _first_clause(error: DuplicateKeyError) -> str:
    return str(error.problem).partition(" with value")[0]
