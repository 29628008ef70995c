"""C99 from the instructions of a traced function."""

import itertools
import re
from collections.abc import Iterator

import casadi as ca
import numpy as np

from tarc.core.c_constants import Constants, Templates
from tarc.core.errors import InvalidParameter, UnsupportedLaw

MIN_COPY = 3
"""Fewest neighbouring elements that are copied together."""

MAX_COPY = 32
"""Most elements of one copy: gcc moves those in registers, and more by a string instruction that is slow to start."""

MAX_SUMS = 8
"""Most sums of a product that are taken at the same time."""

INCLUDES = ("#include <math.h>", "#include <stdbool.h>", "#include <string.h>")
"""What the C of `emit` includes."""


class Interface:
    """How a C function reads its inputs and writes its outputs: here through an array of pointers each."""

    def __init__(self, constants: Constants):
        self.real = constants.type_name

    @property
    def parameters(self) -> str:
        """Return the parameters of the function."""
        return f"const {self.real} *const *arg, {self.real} *const *res"

    def read(self, place: int, element: int) -> str:
        """Return the expression of an element of an input."""
        return f"arg[{place}][{element}]"

    def written(self, place: int, element: int) -> str:
        """Return the expression of an element of an output that is a number of the function's type."""
        return f"res[{place}][{element}]"

    def write(self, place: int, element: int, value: str) -> str:
        """Return the statement that writes an element of an output."""
        return f"  {self.written(place, element)} = {value};"

    def is_input_array(self, place: int) -> bool:
        """Whether an input is one array, parts of which may be copied and handed on."""
        return True

    def has_copies(self, place: int) -> bool:
        """Whether an output is one array, into which parts of inputs may be copied."""
        return True

    def is_output_array(self, place: int) -> bool:
        """Whether an output is one array of the function's type, which is there in every call."""
        return False


class StepInterface(Interface):
    """The interface of a function whose outputs all are there in every call."""

    def is_output_array(self, place: int) -> bool:
        """Whether an output is one array of the function's type, which is there in every call."""
        return True


def emit(
    function: ca.Function, name: str, constants: Constants | None = None, interface: Interface | None = None
) -> str:
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
    interface
        How it reads and writes; None for arrays of pointers.

    Raises
    ------
    InvalidParameter
        For an instruction that has no counterpart in C.
    UnsupportedLaw
        For a call of a library, such as that of MuJoCo by a law with a `MujocoPlant` as its model.
    """
    constants = constants or Constants(in_array=False)
    return "\n".join([*INCLUDES, "", definitions(function, name, constants, interface or Interface(constants))])


def definitions(function: ca.Function, name: str, constants: Constants, interface: Interface) -> str:
    """Return what `emit` does without the includes."""
    parts: list[str] = []
    for callee in _callees(function):
        if not callee.is_a("SXFunction") and not callee.is_a("MXFunction"):
            raise UnsupportedLaw(
                f"native: the law calls {callee.name()}, which a library evaluates and which has no C; leave native "
                "out, or give the law a model in symbols"
            )
        through = Interface(constants)
        if callee.is_a("SXFunction"):
            body = _ScalarBody(callee, constants, through).lines()
        else:
            body = _product_body(callee, constants)
        parts += _definition(callee.name(), body, constants, through)
    parts += _definition(name, _ScalarBody(function, constants, interface).lines(), constants, interface)
    return "\n".join(parts)


def _definition(name: str, body: list[str], constants: Constants, interface: Interface) -> list[str]:
    used = ["  (void)c;"] if constants.in_array else []
    return [f"static void {name}({interface.parameters}{constants.parameter})", "{", *used, *body, "}", ""]


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

    def name(self, index: int) -> str:
        return self._variables[index][0]

    def real(self, index: int) -> str:
        name, is_bool = self._variables[index]
        return self._constants.text(self._constants.templates.real.format(name)) if is_bool else name

    def truth(self, index: int) -> str:
        name, is_bool = self._variables[index]
        return name if is_bool else self._constants.text(self._constants.templates.truth.format(name))


class _ScalarBody:
    """The statements of a function of scalar instructions.

    Outputs are written at the end, so that a compiler need not read an input twice. Inputs that are only passed on to
    outputs are copied in runs. A called function reads its input from the output where both are the same numbers.
    """

    def __init__(self, function: ca.Function, constants: Constants, interface: Interface):
        self._function, self._constants, self._interface = function, constants, interface
        self._lines: list[str] = []
        self._inputs: dict[str, tuple[int, int]] = {}
        self._names = self._output_names()
        self._values: dict[tuple[int, int], str] = {}
        self._written: set[tuple[int, int]] = set()

    def _output_names(self) -> dict[tuple[int, int], str]:
        """Return the variable that each element of an output is written from."""
        function, registers = self._function, _Registers(self._constants)
        names: dict[tuple[int, int], str] = {}
        for k in range(function.n_instructions()):
            outputs = function.instruction_output(k)
            if function.instruction_id(k) == ca.OP_OUTPUT:
                names[outputs[0], outputs[1]] = registers.name(function.instruction_input(k)[0])
                continue
            for element, output in enumerate(outputs):
                registers.put(output, f"out{k}[{element}]" if len(outputs) > 1 else f"a{k}")
        return names

    def lines(self) -> list[str]:
        """Return the statements."""
        function, constants, real = self._function, self._constants, self._constants.type_name
        callees = {callee.name(): callee for callee in _callees(function)}
        called = called_names(function)
        registers = _Registers(constants)
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            inputs, outputs = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                self._values[outputs[0], outputs[1]] = registers.real(inputs[0])
            elif operation == ca.OP_CALL:
                self._call(k, callees[next(called)], inputs, registers)
                for element, output in enumerate(outputs):
                    registers.put(output, f"out{k}[{element}]" if len(outputs) > 1 else f"a{k}")
            elif operation == ca.OP_INPUT:
                self._inputs[f"a{k}"] = (inputs[0], inputs[1])
                self._lines.append(f"  const {real} a{k} = {self._interface.read(inputs[0], inputs[1])};")
                registers.put(outputs[0], f"a{k}")
            else:
                if operation == ca.OP_CONST:
                    text, is_bool = constants.scalar(function.instruction_constant(k)), False
                else:
                    text, is_bool = _expression(function, k, inputs, registers, constants.templates)
                    text = constants.text(text)
                kind = constants.templates.truth_type if is_bool else real
                self._lines.append(f"  const {kind} a{k} = {text};")
                registers.put(outputs[0], f"a{k}", is_bool)
        self._write([place for place in self._values if place not in self._written])
        used = set(re.findall(r"\ba\d+\b", "\n".join(line.partition("=")[2] for line in self._lines)))
        unused = set(self._inputs) - used
        return [line for line in self._lines if line.split(" = ")[0].rpartition(" ")[2] not in unused]

    def _write(self, places: list[tuple[int, int]]) -> None:
        """Add the statements that write elements of outputs: first what is computed, then copies in runs."""
        self._written |= set(places)
        copies: dict[tuple[int, int], tuple[int, int]] = {}
        for place in places:
            name = self._names[place]
            if name in self._inputs:
                copies[place] = self._inputs[name]
            else:
                self._lines.append(self._interface.write(*place, self._values[place]))
        self._lines += _copies(copies, self._interface)

    def _call(self, k: int, callee: ca.Function, inputs: list[int], registers: _Registers) -> None:
        """Add the statements of a call, whose results are in the array ``out<k>``, or in ``a<k>`` where it is one."""
        ends = np.cumsum([0, *(callee.nnz_in(i) for i in range(callee.n_in()))])
        arguments, real = [], self._constants.type_name
        for i, (start, end) in enumerate(itertools.pairwise(ends)):
            part = inputs[start:end]
            pointer = self._array_of([registers.name(index) for index in part], [registers.real(x) for x in part])
            if pointer is None:
                values = ", ".join(registers.real(index) for index in part)
                self._lines.append(f"  const {real} in{k}_{i}[{len(part)}] = {{{values}}};")
                pointer = f"in{k}_{i}"
            arguments.append(pointer)
        ends_out = np.cumsum([0, *(callee.nnz_out(i) for i in range(callee.n_out()))])
        results = ", ".join(f"&out{k}[{start}]" for start in ends_out[:-1])
        self._lines += [
            f"  {real} out{k}[{ends_out[-1]}];",
            f"  const {real} *const args{k}[] = {{{', '.join(arguments)}}};",
            f"  {real} *const results{k}[] = {{{results}}};",
            f"  {callee.name()}(args{k}, results{k}{self._constants.argument});",
        ]
        if ends_out[-1] == 1:
            self._lines.append(f"  const {real} a{k} = out{k}[0];")

    def _array_of(self, names: list[str], values: list[str]) -> str | None:
        """Return a pointer to an input or output that has these variables side by side; None where there is none."""
        if len(names) < MIN_COPY:
            return None
        if names[0] in self._inputs:
            place, first = self._inputs[names[0]]
            run = [(place, first + i) for i in range(len(names))]
            if [self._inputs.get(name) for name in names] == run and self._interface.is_input_array(place):
                return f"&{self._interface.read(place, first)}"
        for (place, first), name in self._names.items():
            run = [(place, first + i) for i in range(len(names))]
            if (
                name == names[0]
                and self._interface.is_output_array(place)
                and [self._names.get(element) for element in run] == names
            ):
                self._values |= dict(zip(run, values, strict=True))
                self._write([element for element in run if element not in self._written])
                return f"&{self._interface.written(place, first)}"
        return None


def _copies(copies: dict[tuple[int, int], tuple[int, int]], interface: Interface) -> list[str]:
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
        are_arrays = interface.is_input_array(source) and interface.has_copies(place)
        if length < MIN_COPY or not are_arrays:
            lines += [interface.write(place, element + i, interface.read(source, first + i)) for i in range(length)]
        else:
            for start in range(0, length, MAX_COPY):
                addresses = f"&{interface.written(place, element + start)}, &{interface.read(source, first + start)}"
                count = min(MAX_COPY, length - start)
                lines.append(f"  (void)memcpy({addresses}, {count}u * sizeof({interface.real}));")
    return lines


def _expression(
    function: ca.Function, k: int, inputs: list[int], registers: _Registers, templates: Templates
) -> tuple[str, bool]:
    """Return the right-hand side of an instruction, and whether it is a truth."""
    operation, real, truth = function.instruction_id(k), registers.real, registers.truth
    if operation in templates.comparisons:
        return templates.comparisons[operation].format(*map(real, inputs)), True
    if operation in templates.logical:
        return templates.logical[operation].format(*map(truth, inputs)), True
    if operation == ca.OP_IF_ELSE_ZERO:
        condition, value = inputs
        return templates.chosen.format(truth(condition), real(value)), False
    if operation in templates.arithmetic:
        return templates.arithmetic[operation].format(*map(real, inputs)), False
    raise InvalidParameter(
        f"{function.name()}: instruction {k} is CasADi's operation {operation}, which has no counterpart in C"
    )


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
    lines = [f"  {constants.vector('weights', weights)}", f"  for (int column = 0; column < {columns}; ++column) {{"]
    for first in range(0, height, MAX_SUMS):
        lines += _row_sums(range(first, min(first + MAX_SUMS, height)), height, rows, constants)
    return [*lines, "  }"]


def _row_sums(some: range, height: int, rows: int, constants: Constants) -> list[str]:
    """Return the statements of the sums of some rows, side by side, which a compiler turns into vectors."""
    real, zero = constants.type_name, constants.spread(constants.text("0.0"))
    lines = ["    {", *(f"      {real} sum{row} = {zero};" for row in some)]
    lines.append(f"      for (int k = 0; k < {rows}; ++k) {{")
    lines.append(f"        const {constants.element_type} weight = weights[k + ({rows} * column)];")
    lines += [f"        sum{row} += arg[0][{_place(height, 'k', row)}] * weight;" for row in some]
    lines.append("      }")
    lines += [f"      res[0][{_place(height, 'column', row)}] = sum{row};" for row in some]
    return [*lines, "    }"]


def _place(height: int, column: str, row: int) -> str:
    """Return the place of an element in a matrix of this height, column by column."""
    return f"({height} * {column}) + {row}" if row else f"{height} * {column}"
