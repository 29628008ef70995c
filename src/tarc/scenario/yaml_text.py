"""Read and write YAML."""

from io import StringIO
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import RoundTripRepresenter

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


class _Representer(RoundTripRepresenter):
    """Write None as ``null``, not as an empty value."""

    def represent_none(self, data: None) -> ScalarNode:
        """Return the node of None."""
        return self.represent_scalar("tag:yaml.org,2002:null", "null")


_Representer.add_representer(type(None), _Representer.represent_none)


def write_yaml(content: object, width: int = 120) -> str:
    """Return data as YAML, in the order of its keys; lists of numbers stand on one line.

    Parameters
    ----------
    content
        Dictionaries, lists, numbers and texts, or the ``CommentedMap`` of ruamel.yaml, whose comments are written.
    width
        Largest number of characters per line.
    """
    yaml = YAML()
    yaml.Representer = _Representer
    yaml.default_flow_style = None
    yaml.width = width
    yaml.allow_unicode = True
    yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()


def _first_clause(error: DuplicateKeyError) -> str:
    return str(error.problem).partition(" with value")[0]
