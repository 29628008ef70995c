"""How numbers and instructions stand in C: expressions by operation, literals, and arrays of constants."""

import re
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core.errors import UnsupportedLaw

LITERALS = frozenset({0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, ops.HUGE})
"""Magnitudes of constants that stand in the text of an equation, and not for a parameter."""
SINGLE_HUGE = 1e30
"""The finite bound in single precision, in which that of `tarc.core.array_ops` would be infinite."""
SINGLE_LIMIT = 3e38
"""Largest constant that single precision holds."""

ARITHMETIC = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_EXP: "exp({0})",
    ca.OP_LOG: "log({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_TAN: "tan({0})",
    ca.OP_ASIN: "asin({0})",
    ca.OP_ACOS: "acos({0})",
    ca.OP_ATAN: "atan({0})",
    ca.OP_SINH: "sinh({0})",
    ca.OP_COSH: "cosh({0})",
    ca.OP_TANH: "tanh({0})",
    ca.OP_FABS: "fabs({0})",
    ca.OP_FLOOR: "floor({0})",
    ca.OP_CEIL: "ceil({0})",
    ca.OP_SIGN: "({0} < 0.0) ? -1.0 : (({0} > 0.0) ? 1.0 : {0})",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    ca.OP_ATAN2: "atan2({0}, {1})",
    ca.OP_FMOD: "fmod({0}, {1})",
    ca.OP_COPYSIGN: "copysign({0}, {1})",
    # of two zeros of opposite sign the first, which fmin and fmax of C leave open
    ca.OP_FMIN: "(({0} <= {1}) || ({1} != {1})) ? {0} : {1}",
    ca.OP_FMAX: "(({0} >= {1}) || ({1} != {1})) ? {0} : {1}",
    ca.OP_HYPOT: "hypot({0}, {1})",
}
COMPARISONS = {
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
}
LOGICAL = {ca.OP_NOT: "!{0}", ca.OP_AND: "{0} && {1}", ca.OP_OR: "{0} || {1}"}


class Templates(NamedTuple):
    """C expressions of the instructions, over the variables of their operands.

    Attributes
    ----------
    arithmetic, comparisons, logical
        By operation: of numbers to a number, of numbers to a truth, and of truths to a truth.
    chosen
        The second operand where the first, a truth, holds, else zero.
    real
        A truth as the number one or zero.
    truth
        Whether a number is not zero.
    truth_type
        Type of truths.
    """

    arithmetic: dict[int, str] = ARITHMETIC
    comparisons: dict[int, str] = COMPARISONS
    logical: dict[int, str] = LOGICAL
    chosen: str = "{0} ? {1} : 0.0"
    real: str = "({0} ? 1.0 : 0.0)"
    truth: str = "({0} != 0.0)"
    truth_type: str = "bool"


PLAIN = Templates()
"""Templates of plain C with the functions of its library."""


class Constants:
    """How the constants of a function stand in C: their type, and whether each call is handed them in an array.

    Functions that differ only in the values of their parameters have the same C with constants in an array, so that
    it is compiled once.

    Parameters
    ----------
    in_array
        Whether each call is handed them in an array.
    single
        Whether numbers are of single precision.
    type_name
        Name of their type in C; None for ``double`` or ``float``.
    templates
        Expressions of the instructions.

    Attributes
    ----------
    values
        The array's numbers, in the order in which they are met.
    """

    def __init__(
        self, in_array: bool, *, single: bool = False, type_name: str | None = None, templates: Templates = PLAIN
    ):
        self.in_array, self.single, self.templates = in_array, single, templates
        self.type_name = type_name or ("float" if single else "double")
        self.values: list[float] = []

    @property
    def element_type(self) -> str:
        """Return the type of the elements of an array of constants."""
        return self.type_name

    def spread(self, expression: str) -> str:
        """Return the expression of a variable's type for one of an element's type."""
        return expression

    def text(self, expression: str) -> str:
        """Return a C expression of double precision in the precision of the constants."""
        if not self.single:
            return expression
        expression = re.sub(r"(?<![\w.])(\d+\.\d+)(?![\w.])", r"\1f", expression)
        return re.sub(r"\b([a-z]+[0-9]?)\(", r"\1f(", expression)

    def number(self, value: float) -> str:
        """Return a C literal that reads back as the same number, in single precision as the nearest.

        The finite bound of `tarc.core.array_ops` becomes `SINGLE_HUGE` there.
        """
        if value != value:
            return "NAN"
        if abs(value) == float("inf"):
            return "INFINITY" if value > 0 else "-INFINITY"
        if self.single and abs(value) >= ops.HUGE:
            value = SINGLE_HUGE if value > 0 else -SINGLE_HUGE
        if self.single and abs(value) > SINGLE_LIMIT:
            raise UnsupportedLaw(f"float: a constant of the law is {value:g}, beyond single precision; use double")
        text = str(np.float32(value)) if self.single else repr(float(value))
        text = text if "." in text or "e" in text else f"{text}.0"
        return f"{text}f" if self.single else text

    def scalar(self, value: float) -> str:
        """Return the C expression of a constant."""
        if not self.in_array or abs(value) in LITERALS or value != value:
            return self.spread(self.number(value))
        self.values.append(value)
        return self.spread(f"c[{len(self.values) - 1}]")

    def vector(self, name: str, values: list[float]) -> str:
        """Return the C declaration of an array of constants."""
        if not self.in_array:
            numbers = ", ".join(map(self.number, values))
            return f"static const {self.element_type} {name}[{len(values)}] = {{{numbers}}};"
        self.values += values
        return f"const {self.element_type} *const {name} = c + {len(self.values) - len(values)};"

    @property
    def parameter(self) -> str:
        """Return the parameter of each function in C."""
        return f", const {self.element_type} *c" if self.in_array else ""

    @property
    def argument(self) -> str:
        """Return the argument of each call in C."""
        return ", c" if self.in_array else ""
