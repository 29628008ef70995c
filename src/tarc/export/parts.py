"""Parts of a law as C functions of their own: its estimator, M̂(q) of its model, and the reference."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from tarc.core.c_constants import Constants
from tarc.core.c_emitter import Interface, definitions
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.tracing import trace
from tarc.core.trees import pack
from tarc.core.types import Array
from tarc.export import parts_texts, vectors
from tarc.export.c_source import DIRECTIVES, CSource, calls_library
from tarc.export.single_precision import SinglePrecision
from tarc.export.tolerances import TOLERANCES
from tarc.export.traced_law import affine
from tarc.laws.nominal_inertia import NominalInertia
from tarc.signals.references import PolynomialPieces, Reference

MAX_COEFFICIENTS = 100_000
"""Most numbers of a reference's table in C."""

STEPS = {"estimator": 120, "inertia": 20, "reference": 60}
"""Recorded calls of each part."""

ESTIMATE = ("position", "velocity", "acceleration", "valid")
"""Fields of an estimate, in order."""


class _Arrays(Interface):
    """Inputs and outputs that are arrays by name."""

    def __init__(self, constants: Constants, inputs: tuple[str, ...], outputs: tuple[str, ...], declared: str):
        super().__init__(constants)
        self._inputs, self._outputs, self._declared = inputs, outputs, declared

    @property
    def parameters(self) -> str:
        return self._declared

    def read(self, place: int, element: int) -> str:
        return f"{self._inputs[place]}[{element}]"

    def written(self, place: int, element: int) -> str:
        return f"{self._outputs[place]}[{element}]"


class _Estimator(_Arrays):
    """State and position in, next state and estimate out."""

    def __init__(self, constants: Constants, name: str, n_joints: int):
        real = constants.type_name
        declared = f"const {real} *state, const {real} *position, {real} *next, {name}_estimate *out"
        super().__init__(constants, ("state", "position"), ("next", "out"), declared)
        self._n_joints = n_joints

    def written(self, place: int, element: int) -> str:
        if place == 0:
            return super().written(place, element)
        return f"out->{ESTIMATE[element // self._n_joints]}[{element % self._n_joints}]"

    def write(self, place: int, element: int, value: str) -> str:
        target = self.written(place, element)
        return f"  {target} = {'(int)' if target.startswith('out->valid') else ''}{value};"

    def has_copies(self, place: int) -> bool:
        return place == 0

    def is_output_array(self, place: int) -> bool:
        return place == 0


class _Inertia(_Arrays):
    """Position in, matrix out."""

    def __init__(self, constants: Constants, n_joints: int):
        real = constants.type_name
        super().__init__(
            constants, ("position",), ("inertia",), f"const {real} *position, {real} inertia[{n_joints}][{n_joints}]"
        )
        self._n_joints = n_joints

    def written(self, place: int, element: int) -> str:
        return f"inertia[{element % self._n_joints}][{element // self._n_joints}]"

    def has_copies(self, place: int) -> bool:
        return False


class _Time(_Arrays):
    """Time in, position and two derivatives out."""

    def __init__(self, constants: Constants):
        real = constants.type_name
        outputs = ("position", "velocity", "acceleration")
        declared = f"{real} time, {', '.join(f'{real} *{name}' for name in outputs)}"
        super().__init__(constants, ("time",), outputs, declared)

    def read(self, place: int, element: int) -> str:
        return "time"

    def is_input_array(self, place: int) -> bool:
        return False


@dataclass(frozen=True)
class Parts:
    """The C of the parts of a law.

    Attributes
    ----------
    source
        The law in C, whose type of numbers and names they share.
    reference
        The reference, or None to leave it out.
    """

    source: CSource
    reference: Reference | None

    @property
    def names(self) -> list[str]:
        """Return the parts that there are."""
        has = {"estimator": True, "inertia": self._model is not None, "reference": self.reference is not None}
        return [name for name, is_present in has.items() if is_present]

    def texts(self) -> dict[str, str]:
        """Return header, source, test and its expected bits by path.

        Raises
        ------
        UnsupportedLaw
            For a part that has no C, with the part's name.
        """
        name = self.source.name
        return {
            f"src/{name}_parts.h": self.header,
            f"src/{name}_parts.c": self.code,
            "test/parts.c": self._test,
            "test/parts_vectors.h": self._vectors,
        }

    @property
    def digest(self) -> str:
        """Return the SHA-256 of header and source together."""
        return hashlib.sha256((self.header + self.code).encode()).hexdigest()

    @cached_property
    def header(self) -> str:
        """Return the header."""
        law = self.source.traced.law
        values = self._values | {
            "kind": type(law.estimator).__name__,
            "period": f"{law.period:g}",
            "n_states": str(max(self._estimator.nnz_in(0), 1)),
        }
        declarations = {
            "estimator": parts_texts.ESTIMATOR_HEADER.substitute(values),
            "inertia": parts_texts.INERTIA_HEADER.substitute(values),
            "reference": parts_texts.REFERENCE_HEADER.substitute(values | {"kind": type(self.reference).__name__}),
        }
        text = "".join(declarations[name] for name in self.names)
        return parts_texts.HEADER.substitute(self._values, declarations=text)

    @cached_property
    def code(self) -> str:
        """Return the source."""
        makers: dict[str, Callable[[], str]] = {
            "estimator": self._estimator_text,
            "inertia": self._inertia_text,
            "reference": self._reference_text,
        }
        text = "".join(makers[name]() for name in self.names)
        return parts_texts.SOURCE.substitute(self._values, directives=DIRECTIVES, definitions=text)

    @cached_property
    def _model(self) -> NominalInertia | None:
        inertia = getattr(self.source.traced.law, "inertia", None)
        return inertia if isinstance(inertia, NominalInertia) else None

    @cached_property
    def _estimator(self) -> ca.Function:
        law = self.source.traced.law
        zero = np.zeros(law.n_joints)
        return trace(law.estimator.step, law.estimator.init(zero), zero, name="estimator")[0]

    @cached_property
    def _estimator_start(self) -> ca.Function:
        estimator, n = self.source.traced.law.estimator, self.source.traced.n_joints
        position = ca.SX.sym("q", n)
        rows = affine(lambda q: pack(estimator.init(q)), position, np.ones(n), type(estimator).__name__)
        return ca.Function("estimator_start", [position], [rows], {"cse": True})

    @cached_property
    def _inertia(self) -> ca.Function:
        assert self._model is not None
        position = ca.SX.sym("q", self.source.traced.n_joints)
        return ca.Function("inertia", [position], [ca.densify(ca.SX(self._model.at(position)))], {"cse": True})

    @cached_property
    def _pieces(self) -> PolynomialPieces | None:
        assert self.reference is not None
        pieces = self.reference.pieces()
        if pieces is not None and pieces.coefficients.size > MAX_COEFFICIENTS:
            raise UnsupportedLaw(
                f"reference: its table has {pieces.coefficients.size} numbers, more than the {MAX_COEFFICIENTS} that "
                "go into C; thin the record out, or leave the reference out"
            )
        return pieces

    @cached_property
    def _formula(self) -> ca.Function:
        assert self.reference is not None
        time = ca.SX.sym("t")
        outputs = [ca.densify(ca.SX(expression)) for expression in self.reference.at(time)]
        return ca.Function("reference", [time], outputs, {"cse": True})

    @property
    def _constants(self) -> Constants:
        return Constants(in_array=False, single=self.source.single, type_name=f"{self.source.name}_real")

    @property
    def _values(self) -> dict[str, str]:
        name, constants = self.source.name, self._constants
        return {
            "name": name,
            "NAME": name.upper(),
            "title": self.source.title,
            "fabs": constants.text("fabs(")[:-1],
            "huge": constants.number(1e100),
            "zero": constants.number(0.0),
            "two": constants.number(2.0),
        }

    def _estimator_text(self) -> str:
        constants, name = self._constants, self.source.name
        real = constants.type_name
        start = _Arrays(constants, ("position",), ("state",), f"const {real} *position, {real} *state")
        functions = definitions(self._estimator_start, "estimator_start", constants, start)
        step = _Estimator(constants, name, self.source.traced.n_joints)
        functions += "\n" + definitions(self._estimator, "estimator_step", constants, step)
        return parts_texts.ESTIMATOR.substitute(self._values, functions=functions)

    def _inertia_text(self) -> str:
        interface = _Inertia(self._constants, self.source.traced.n_joints)
        functions = definitions(self._inertia, "inertia_function", self._constants, interface)
        return parts_texts.INERTIA.substitute(self._values, functions=functions)

    def _reference_text(self) -> str:
        pieces = self._pieces
        if pieces is None:
            functions = definitions(self._formula, "reference_function", self._constants, _Time(self._constants))
        else:
            number = self._constants.number

            def row(values: Array) -> str:
                return "{" + ", ".join(number(float(value)) for value in values) + "}"

            table = ",\n".join(f"    {{{', '.join(map(row, piece))}}}" for piece in pieces.coefficients)
            functions = parts_texts.PIECES.substitute(
                self._values,
                count=len(pieces.coefficients),
                starts=row(pieces.times)[1:-1],
                coefficients=f"{table}\n",
                end=row(pieces.end)[1:-1],
            )
        return parts_texts.REFERENCE.substitute(self._values, functions=functions)

    @cached_property
    def recorded(self) -> dict[str, tuple[Array, Array]]:
        """Return inputs and outputs of recorded calls of each part, one per row."""
        return {name: getattr(self, f"_recorded_{name}")() for name in self.names}

    def _called(self, function: ca.Function, *values: Array) -> list[Array]:
        if self.source.single:
            return SinglePrecision(function)(*values)
        outputs = function.call([ca.DM(value) for value in values])
        return [np.array(output).ravel(order="F") for output in outputs]

    @property
    def _real(self) -> type[np.floating]:
        return np.float32 if self.source.single else np.float64

    def _recorded_estimator(self) -> tuple[Array, Array]:
        n = self.source.traced.n_joints
        with np.errstate(over="ignore"):
            positions = vectors.random_inputs(n, STEPS["estimator"], 2)[2][:, :n].astype(self._real)
        positions[0] = np.where(np.isfinite(positions[0]), positions[0], 0.0)
        (state,) = self._called(self._estimator_start, positions[0])
        outputs = []
        for row in positions:
            state, output = self._called(self._estimator, state, row)
            outputs.append(output)
        return positions, np.array(outputs)

    def _recorded_inertia(self) -> tuple[Array, Array]:
        rng = np.random.default_rng(3)
        positions = rng.uniform(-2, 2, (STEPS["inertia"], self.source.traced.n_joints)).astype(self._real)
        return positions, np.array([self._called(self._inertia, row)[0] for row in positions])

    def _recorded_reference(self) -> tuple[Array, Array]:
        assert self.reference is not None
        n, pieces = self.reference.n_joints, self._pieces
        if n != self.source.traced.n_joints:
            raise InvalidParameter(f"reference: got one of {n} joints; needs one of {self.source.traced.n_joints}")
        first, last = (0.0, 10.0) if pieces is None else pieces.times[[0, -1]]
        times = np.linspace(first - 0.1 * (last - first), last + 0.1 * (last - first), STEPS["reference"])
        times = times.astype(self._real)
        times[-1] = np.nan
        rows = []
        for time in times:
            if pieces is None and np.isfinite(time):
                rows.append(np.concatenate(self._called(self._formula, np.array([time]))))
            else:
                rows.append(np.full(3 * n, np.nan) if pieces is None else piecewise(pieces, time))
        return times[:, None], np.array(rows, dtype=self._real)

    @property
    def _test(self) -> str:
        values = self._values | {"tolerance": TOLERANCES[self.source.real]}
        functions = {
            "estimator": parts_texts.ESTIMATOR_TEST,
            "inertia": parts_texts.INERTIA_TEST,
            "reference": parts_texts.REFERENCE_TEST,
        }
        calls = []
        for name in self.names:
            calls += [f"  test_{name}();"]
        n_numbers = sum(outputs.size for _, outputs in self.recorded.values())
        text = f"{' and '.join(self.names)}: %ld of {n_numbers} numbers differ; %ld by more than rounding\\n"
        calls.append(f'  printf("{text}", different, wrong);')
        return parts_texts.TEST.substitute(
            values,
            functions="".join(functions[name].substitute(values) for name in self.names),
            calls="\n".join(calls) + "\n",
        )

    @property
    def _vectors(self) -> str:
        kind = "uint32_t" if self.source.single else "uint64_t"
        exact = int(not calls_library(self.code, self.source.single))
        lines = ["/* Calls of the parts as Python computes them, as bits. */", "#include <stdint.h>", ""]
        lines += [f"typedef {kind} bits;", f"#define PARTS_EXACT {exact}"]
        for name, (inputs, outputs) in self.recorded.items():
            lines.append(f"#define {name.upper()}_STEPS {len(inputs)}")
            for label, table in (("inputs", inputs), ("outputs", outputs)):
                rows = vectors.bit_rows(table, self.source.single)
                lines.append(f"static const bits {name}_{label}[{len(table)}][{table.shape[1]}] = {{\n{rows}\n}};")
        return "\n".join(lines) + "\n"


def piecewise(pieces: PolynomialPieces, time: float) -> Array:
    """Return position, velocity and acceleration at a time, shape (3 n,), operation by operation as the C does.

    Parameters
    ----------
    pieces
        The polynomials.
    time
        [s], of single or double precision, in which everything is computed.
    """
    real = type(time)
    times, coefficients, end = (np.asarray(part).astype(real) for part in pieces)
    zero = np.zeros(end.size, dtype=real)
    if np.isnan(time):
        return np.full(3 * end.size, np.nan, dtype=real)
    if time < times[0] or time > times[-1]:
        return np.concatenate([coefficients[0, 0] if time < times[0] else end, zero, zero])
    first = min(int(np.searchsorted(times, time, side="right")) - 1, len(coefficients) - 1)
    elapsed = time - times[first]
    q, v, a = coefficients[first, 5], zero, zero
    for j in range(4, -1, -1):
        a = a * elapsed + v
        v = v * elapsed + q
        q = q * elapsed + coefficients[first, j]
    return np.concatenate([q, v, real(2) * a])
