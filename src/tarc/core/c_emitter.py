"""C99 from the instructions of a traced function."""

import re
from collections.abc import Iterator

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core.errors import InvalidParameter, UnsupportedLaw

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
    ca.OP_SIGN: "{0} < 0.0 ? -1.0 : {0} > 0.0 ? 1.0 : {0}",
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
    ca.OP_FMIN: "{0} <= {1} || {1} != {1} ? {0} : {1}",
    ca.OP_FMAX: "{0} >= {1} || {1} != {1} ? {0} : {1}",
    ca.OP_HYPOT: "hypot({0}, {1})",
}
COMPARISONS = {
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
}
LOGICAL = {ca.OP_NOT: "!{0}", ca.OP_AND: "{0} && {1}", ca.OP_OR: "{0} || {1}"}


MIN_COPY = 3
"""Fewest neighbouring elements that are copied together."""

LITERALS = frozenset({0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, ops.HUGE})
"""Magnitudes of constants that stand in the text of an equation, and not for a parameter."""


SINGLE_HUGE = 1e30
"""The finite bound in single precision, in which that of `tarc.core.array_ops` would be infinite."""

SINGLE_LIMIT = 3e38
"""Largest constant that single precision holds."""


INCLUDES = ("#include <math.h>", "#include <stdbool.h>", "#include <string.h>")
"""What the C of `emit` includes."""


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

    Attributes
    ----------
    values
        The array's numbers, in the order in which they are met.
    """

    def __init__(self, in_array: bool, *, single: bool = False, type_name: str | None = None):
        self.in_array, self.single = in_array, single
        self.type_name = type_name or ("float" if single else "double")
        self.values: list[float] = []

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
            return self.number(value)
        self.values.append(value)
        return f"c[{len(self.values) - 1}]"

    def vector(self, name: str, values: list[float]) -> str:
        """Return the C declaration of an array of constants."""
        if not self.in_array:
            return f"static const {self.type_name} {name}[{len(values)}] = {{{', '.join(map(self.number, values))}}};"
        self.values += values
        return f"const {self.type_name} *const {name} = c + {len(self.values) - len(values)};"

    @property
    def parameter(self) -> str:
        """Return the parameter of each function in C."""
        return f", const {self.type_name} *c" if self.in_array else ""

    @property
    def argument(self) -> str:
        """Return the argument of each call in C."""
        return ", c" if self.in_array else ""


def emit(function: ca.Function, name: str, constants: Constants | None = None) -> str:
    """Return C99 source of a traced function and of the functions that it calls.

    It defines ``static void NAME(const double *const *arg, double *const *res)``, with ``const double *c`` at the end
    where the constants are in an array. Each input or output is the column of its stored elements, as CasADi orders
    them. The statements follow the instructions one by one. A compiler that does not contract products
    (``-ffp-contract=off``) gives the numbers of CasADi's virtual machine to the last bit. Comparisons are of the type
    ``bool``.

    Parameters
    ----------
    function
        Traced with ``casadi.SX``. What it calls is traced so too, or multiplies its input by a constant matrix.
    name
        Name of the function in C.
    constants
        Where constants stand, filled with those of the function; None for in the C.

    Raises
    ------
    InvalidParameter
        For an instruction that has no counterpart in C.
    UnsupportedLaw
        For a call of a library, such as that of MuJoCo by a law with a `MujocoPlant` as its model.
    """
    return "\n".join([*INCLUDES, "", definitions(function, name, constants or Constants(in_array=False))])


def definitions(function: ca.Function, name: str, constants: Constants) -> str:
    """Return what `emit` does without the includes."""
    parts: list[str] = []
    for callee in _callees(function):
        if not callee.is_a("SXFunction") and not callee.is_a("MXFunction"):
            raise UnsupportedLaw(
                f"native: the law calls {callee.name()}, which a library evaluates and which has no C; leave native "
                "out, or give the law a model in symbols"
            )
        body = _scalar_body if callee.is_a("SXFunction") else _product_body
        parts += _definition(callee.name(), body(callee, constants), constants)
    parts += _definition(name, _scalar_body(function, constants), constants)
    return "\n".join(parts)


def _definition(name: str, body: list[str], constants: Constants) -> list[str]:
    real = constants.type_name
    parameters = f"const {real} *const *arg, {real} *const *res{constants.parameter}"
    used = ["  (void)c;"] if constants.in_array else []
    return [f"static void {name}({parameters})", "{", *used, *body, "}", ""]


def _callees(function: ca.Function) -> list[ca.Function]:
    """Return the functions that are called, directly or not, each once and after those that it calls itself."""
    ordered: dict[str, ca.Function] = {}
    for callee in function.find_functions(0):
        ordered |= {inner.name(): inner for inner in _callees(callee)}
        ordered[callee.name()] = callee
    return list(ordered.values())


def called_names(function: ca.Function) -> Iterator[str]:
    """Return the names of the called functions in the order of the calls, which only the printed algorithm has."""
    return iter(re.findall(r"^\[.*\] = (\w+)\(", function.str(True), re.MULTILINE))


class _Registers:
    """The C variable that each register of the virtual machine is in, and whether it is a ``bool``."""

    def __init__(self, constants: Constants) -> None:
        self._constants = constants
        self._variables: dict[int, tuple[str, bool]] = {}

    def put(self, index: int, name: str, is_bool: bool = False) -> None:
        self._variables[index] = (name, is_bool)

    def real(self, index: int) -> str:
        name, is_bool = self._variables[index]
        return self._constants.text(f"({name} ? 1.0 : 0.0)") if is_bool else name

    def truth(self, index: int) -> str:
        name, is_bool = self._variables[index]
        return name if is_bool else self._constants.text(f"({name} != 0.0)")


def _scalar_body(function: ca.Function, constants: Constants) -> list[str]:
    """Return the statements of a function of scalar instructions.

    Inputs that are only passed on to outputs are copied in runs at the end.
    """
    lines: list[str] = []
    copies: dict[tuple[int, int], tuple[int, int]] = {}
    inputs_of: dict[str, tuple[int, int]] = {}
    callees = {callee.name(): callee for callee in _callees(function)}
    called = called_names(function)
    registers = _Registers(constants)
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs = function.instruction_input(k)
        outputs = function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            place, element = outputs
            name = registers.real(inputs[0])
            if name in inputs_of:
                copies[place, element] = inputs_of[name]
            else:
                lines.append(f"  res[{place}][{element}] = {name};")
        elif operation == ca.OP_CALL:
            values = [registers.real(index) for index in inputs]
            lines += _call(k, callees[next(called)], values, len(outputs), constants)
            for element, output in enumerate(outputs):
                registers.put(output, f"out{k}[{element}]")
        elif operation == ca.OP_INPUT:
            inputs_of[f"a{k}"] = (inputs[0], inputs[1])
            lines.append(f"  const {constants.type_name} a{k} = arg[{inputs[0]}][{inputs[1]}];")
            registers.put(outputs[0], f"a{k}")
        else:
            if operation == ca.OP_CONST:
                text, is_bool = constants.scalar(function.instruction_constant(k)), False
            else:
                text, is_bool = _expression(function, k, operation, inputs, registers)
                text = constants.text(text)
            lines.append(f"  const {'bool' if is_bool else constants.type_name} a{k} = {text};")
            registers.put(outputs[0], f"a{k}", is_bool)
    used = set(re.findall(r"\ba\d+\b", "\n".join(line.partition("=")[2] for line in lines)))
    unused = set(inputs_of) - used
    kept = [line for line in lines if line.split(" = ")[0].rpartition(" ")[2] not in unused]
    return [*kept, *_copies(copies, constants)]


def _copies(copies: dict[tuple[int, int], tuple[int, int]], constants: Constants) -> list[str]:
    """Return the statements that copy elements of inputs to elements of outputs, neighbours together."""
    lines: list[str] = []
    runs: list[list[int]] = []  # output, its first element, input, its first element, length
    for (place, element), (source, first) in sorted(copies.items()):
        if runs:
            *_, length = last = runs[-1]
            if [place, element, source, first] == [last[0], last[1] + length, last[2], last[3] + length]:
                last[4] += 1
                continue
        runs.append([place, element, source, first, 1])
    for place, element, source, first, length in runs:
        if length < MIN_COPY:
            lines += [f"  res[{place}][{element + i}] = arg[{source}][{first + i}];" for i in range(length)]
        else:
            size = f"{length} * sizeof({constants.type_name})"
            lines.append(f"  memcpy(res[{place}] + {element}, arg[{source}] + {first}, {size});")
    return lines


def _expression(
    function: ca.Function, k: int, operation: int, inputs: list[int], registers: _Registers
) -> tuple[str, bool]:
    """Return the right-hand side of an instruction, and whether it is a ``bool``."""
    real, truth = registers.real, registers.truth
    if operation in COMPARISONS:
        return COMPARISONS[operation].format(*map(real, inputs)), True
    if operation in LOGICAL:
        return LOGICAL[operation].format(*map(truth, inputs)), True
    if operation == ca.OP_IF_ELSE_ZERO:
        condition, value = inputs
        return f"{truth(condition)} ? {real(value)} : 0.0", False
    if operation in ARITHMETIC:
        return ARITHMETIC[operation].format(*map(real, inputs)), False
    raise InvalidParameter(
        f"{function.name()}: instruction {k} is CasADi's operation {operation}, which has no counterpart in C"
    )


def _call(k: int, callee: ca.Function, values: list[str], n_outputs: int, constants: Constants) -> list[str]:
    """Return the statements of a call, whose results are in the array ``out<k>``."""
    ends_in = np.cumsum([0, *(callee.nnz_in(i) for i in range(callee.n_in()))])
    ends_out = np.cumsum([0, *(callee.nnz_out(i) for i in range(callee.n_out()))])
    arguments = ", ".join(f"in{k} + {start}" for start in ends_in[:-1])
    results = ", ".join(f"out{k} + {start}" for start in ends_out[:-1])
    real = constants.type_name
    return [
        f"  const {real} in{k}[{len(values)}] = {{{', '.join(values)}}};",
        f"  {real} out{k}[{n_outputs}];",
        f"  const {real} *const args{k}[] = {{{arguments}}};",
        f"  {real} *const results{k}[] = {{{results}}};",
        f"  {callee.name()}(args{k}, results{k}{constants.argument});",
    ]


def _product_body(function: ca.Function, constants: Constants) -> list[str]:
    """Return the statements of a product of the one input (n, m) with a constant matrix (m, p) on its right."""
    operations = [function.instruction_id(k) for k in range(function.n_instructions())]
    if sorted(operations) != sorted([ca.OP_CONST, ca.OP_CONST, ca.OP_INPUT, ca.OP_MTIMES, ca.OP_OUTPUT]):
        raise InvalidParameter(f"{function.name()}: it is called, and is no product with a constant matrix")
    _, _, register = function.instruction_input(operations.index(ca.OP_MTIMES))
    (constant,) = [
        function.instruction_MX(k).to_DM()
        for k, operation in enumerate(operations)
        if operation == ca.OP_CONST and function.instruction_output(k) == [register]
    ]
    rows, columns = constant.shape
    height = function.size1_in(0)
    weights = [float(number) for number in np.array(constant).T.ravel()]
    return [
        f"  {constants.vector('weights', weights)}",
        f"  for (int column = 0; column < {columns}; ++column)",
        f"    for (int row = 0; row < {height}; ++row) {{",
        f"      {constants.type_name} sum = {constants.text('0.0')};",
        f"      for (int k = 0; k < {rows}; ++k)",
        f"        sum += arg[0][row + {height} * k] * weights[k + {rows} * column];",
        f"      res[0][row + {height} * column] = sum;",
        "    }",
    ]
