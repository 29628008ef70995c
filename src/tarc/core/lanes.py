"""Traced functions over several runs at once: one C text for one run and for vectors of runs."""

import casadi as ca

from tarc.core.c_constants import Constants, Templates
from tarc.core.lanes_c import FUNCTIONS, TYPES

ARITHMETIC = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "each_sqrt({0})",
    ca.OP_EXP: "own_exp({0})",
    ca.OP_LOG: "own_log({0})",
    ca.OP_SIN: "own_sin({0})",
    ca.OP_COS: "own_cos({0})",
    ca.OP_TAN: "each_tan({0})",
    ca.OP_ASIN: "each_asin({0})",
    ca.OP_ACOS: "each_acos({0})",
    ca.OP_ATAN: "each_atan({0})",
    ca.OP_SINH: "each_sinh({0})",
    ca.OP_COSH: "each_cosh({0})",
    ca.OP_TANH: "own_tanh({0})",
    ca.OP_FABS: "MAGNITUDE({0})",
    ca.OP_FLOOR: "each_floor({0})",
    ca.OP_CEIL: "each_ceil({0})",
    ca.OP_SIGN: "PICK(LESS({0}, 0.0), ALL(-1.0), PICK(LESS(0.0, {0}), ALL(1.0), {0}))",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "each_pow({0}, {1})",
    ca.OP_CONSTPOW: "each_pow({0}, {1})",
    ca.OP_ATAN2: "each_atan2({0}, {1})",
    ca.OP_FMOD: "each_fmod({0}, {1})",
    ca.OP_COPYSIGN: "WITH_SIGN({0}, {1})",
    ca.OP_FMIN: "PICK(OR(AT_MOST({0}, {1}), DIFFERENT({1}, {1})), {0}, {1})",
    ca.OP_FMAX: "PICK(OR(AT_MOST({1}, {0}), DIFFERENT({1}, {1})), {0}, {1})",
    ca.OP_HYPOT: "each_hypot({0}, {1})",
}

LANES = Templates(
    arithmetic=ARITHMETIC,
    comparisons={
        ca.OP_LT: "LESS({0}, {1})",
        ca.OP_LE: "AT_MOST({0}, {1})",
        ca.OP_EQ: "EQUAL({0}, {1})",
        ca.OP_NE: "DIFFERENT({0}, {1})",
    },
    logical={ca.OP_NOT: "NOT({0})", ca.OP_AND: "AND({0}, {1})", ca.OP_OR: "OR({0}, {1})"},
    chosen="PICK_OR_ZERO({0}, {1})",
    real="ONE_IF({0})",
    truth="DIFFERENT({0}, 0.0)",
    truth_type="TRUTH",
)
"""Expressions over the types of `tarc.core.lanes_c`."""

PRELUDE = f"{TYPES}{FUNCTIONS}"
"""What C of these templates begins with, compiled with ``-DLANES=`` and their number."""


class LaneConstants(Constants):
    """Constants in an array that all runs share."""

    def __init__(self) -> None:
        super().__init__(in_array=True, type_name="REAL", templates=LANES)

    @property
    def element_type(self) -> str:
        """Return the type of the elements of an array of constants."""
        return "double"

    def spread(self, expression: str) -> str:
        """Return a number in all lanes."""
        return f"ALL({expression})"
