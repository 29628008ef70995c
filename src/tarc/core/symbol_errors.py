"""Errors of equations that decide by the value of a symbol, in words."""

import traceback
from pathlib import Path

SIGNS = ("truth value", "Did you mean to iterate", "'to_double' not defined")
"""Parts of the messages of CasADi and NumPy for `if`, loops and numbers of a symbol."""

REPLACEMENTS = {
    "truth value": "`if`, `and`, `or`, `not`, `min` and `max` need one number, and this is a vector or a symbol "
    "without a value. Write where(condition, yes, no), logical_and, logical_or, logical_not, minimum and maximum",
    "Did you mean to iterate": "a loop over the joints needs numbers. Write the equation for the whole vector, shape "
    "(n,), or index it with x[0], x[1]",
    "'to_double' not defined": "float() and the functions of `math` need one number. Write sin, exp, tanh and so on",
}
"""What to write instead, of `tarc.core.array_ops`."""


def place_of(error: BaseException) -> str:
    """Return file, line and source of the last step of an error outside installed libraries."""
    steps = [step for step in traceback.extract_tb(error.__traceback__) if "site-packages" not in step.filename]
    if not steps:
        return ""
    return f"{Path(steps[-1].filename).name}, line {steps[-1].lineno}: `{steps[-1].line}`"


def explain_symbol_error(error: BaseException) -> str:
    """Return what to write instead where an equation decides by a symbol; empty for any other error."""
    message = str(error)
    for sign in SIGNS:
        if sign in message:
            return f"{place_of(error)}. {REPLACEMENTS[sign]}, of tarc.core.array_ops"
    return ""
