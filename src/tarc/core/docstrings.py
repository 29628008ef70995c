"""Parts of docstrings in NumPy format."""

import inspect
import re
from typing import Any


def parameter_texts(documented: Any) -> dict[str, str]:
    """Return the text of each parameter in the docstring of a class or function, on one line.

    Examples
    --------
    >>> parameter_texts(parameter_texts)
    {'documented': 'The class or function.'}

    Parameters
    ----------
    documented
        The class or function.
    """
    section = re.search(r"^Parameters\n-+\n(.*?)(?=\n\S[^\n]*\n-+\n|\Z)", inspect.getdoc(documented) or "", re.M | re.S)
    texts: dict[str, str] = {}
    for entry in re.finditer(r"^(\S[^\n]*)\n((?: +[^\n]*\n?|\n)+)", section[1] + "\n" if section else "", re.M):
        text = " ".join(entry[2].split())
        texts |= {name: text for name in entry[1].split(", ")}
    return texts
