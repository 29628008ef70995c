"""A traced step with its loop over periods in machine code, for several runs at once."""

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.core.c_emitter import Interface, definitions
from tarc.core.codegen import compiled_library
from tarc.core.errors import InvalidParameter
from tarc.core.lanes import PRELUDE, LaneConstants
from tarc.core.tracing import n_distinct_instructions
from tarc.core.types import Array

OPTIONS = ("-fno-math-errno", "-fno-trapping-math")
"""Neither changes a number; with them, square roots and roundings are instructions of the processor."""

LARGE = 4000
"""Instructions from which a step is compiled with fewer optimisations, which take long and gain little there."""

ALIGNMENT = 64

SHARED, OWN, PARAMETER = "shared", "own", "p"
"""Where an element of the input is: in all runs the same in a period, of each run in a period, or of each run."""

LOOP = """
static inline bool is_lane(TRUTH m, int i)
{
#if LANES > 1
  return m[i];
#else
  (void)i;
  return m;
#endif
}

void run(long periods, long measured, REAL *now, REAL *next, const double *shared, const REAL *own, const REAL *p,
         REAL *record, long long *ends, const double *c);
void run(long periods, long measured, REAL *now, REAL *next, const double *shared, const REAL *own, const REAL *p,
         REAL *record, long long *ends, const double *c)
{
  REAL *const result = now;
  TRUTH gone = LESS(ALL(1.0), 0.0);
  int n_gone = 0;
  for (long k = 0; k < periods; ++k) {
    REAL bounded[1];
    if (k == measured)
      for (int i = FIRST_SUM; i < N_STATE; ++i)
        now[i] = ALL(0.0);
    step(now, shared + N_SHARED * k, own + N_OWN * k, p, next, record + N_RECORD * k, bounded, c);
    const TRUTH beyond = DIFFERENT(bounded[0], 1.0);
    if (n_gone || some(beyond)) {
      gone = OR(gone, beyond);
      for (int i = 0; i < LANES; ++i)
        if (is_lane(beyond, i) && ends[i] < 0) {
          ends[i] = k;
          ++n_gone;
        }
      if (n_gone == LANES)
        break;
      for (int i = 0; i < N_STATE; ++i)
        next[i] = PICK(gone, now[i], next[i]);
    }
    REAL *const before = now;
    now = next;
    next = before;
  }
  if (now != result)
    memcpy(result, now, N_STATE * sizeof(REAL));
}
"""
"""A lane that is out of bounds keeps its state from then on; the loop ends when all are."""


class _LaneInterface(Interface):
    """State and input of a step, of which each element is in one of several arrays; outputs in three."""

    WRITTEN = ("next", "record", "bounded")

    def __init__(self, constants: LaneConstants, places: Sequence[tuple[str, int]]):
        super().__init__(constants)
        self._places = places

    @property
    def parameters(self) -> str:
        """Return the parameters of the function."""
        return (
            "const REAL *restrict now, const double *restrict shared, const REAL *restrict own, "
            "const REAL *restrict p, REAL *restrict next, REAL *restrict record, REAL *restrict bounded"
        )

    def read(self, place: int, element: int) -> str:
        """Return the expression of an element of an input."""
        if place == 0:
            return f"now[{element}]"
        array, index = self._places[element]
        return f"ALL({array}[{index}])" if array == SHARED else f"{array}[{index}]"

    def written(self, place: int, element: int) -> str:
        """Return the expression of an element of an output."""
        return f"{self.WRITTEN[place]}[{element}]"

    def is_input_array(self, place: int) -> bool:
        """Whether an input is one array: the state is."""
        return place == 0

    def is_output_array(self, place: int) -> bool:
        """Whether an output is one array."""
        return True


class LaneResult(NamedTuple):
    """State after the last period (states, lanes), record (periods, numbers, lanes), and where lanes ended, (lanes,).

    ``ends`` is the period in which a lane was out of bounds for the first time, or −1.
    """

    state: Array
    record: Array
    ends: Array


class LaneLoop:
    """A step and its loop over periods in machine code, for as many runs at once as there are lanes.

    Parameters
    ----------
    function
        ``[state, input] -> [next state, record, bounded]``. A lane ends where ``bounded`` is not one.
    places
        Array and index of each element of the input, of `SHARED`, `OWN` or `PARAMETER`.
    n_sums
        Number of states at the end that are set to zero when measuring begins.
    lanes
        Number of runs at once: 8, 4, 2 or 1.

    Raises
    ------
    MissingTool
        When there is no compiler.
    CompilationError
        When the compiler fails, or the cache cannot be written.
    """

    def __init__(self, function: ca.Function, places: Sequence[tuple[str, int]], n_sums: int, lanes: int):
        self.lanes = lanes
        self._n_state, self._n_record = function.nnz_in(0), function.nnz_out(1)
        if len(places) != function.nnz_in(1):
            raise InvalidParameter(f"places: got {len(places)}; the input has {function.nnz_in(1)} elements")
        self._counts = {
            name: 1 + max([i for array, i in places if array == name], default=-1) for name in (SHARED, OWN, PARAMETER)
        }
        constants = LaneConstants()
        sizes = {
            "N_STATE": self._n_state,
            "FIRST_SUM": self._n_state - n_sums,
            "N_SHARED": self._counts[SHARED],
            "N_OWN": self._counts[OWN],
            "N_RECORD": self._n_record,
        }
        body = definitions(function, "step", constants, _LaneInterface(constants, places))
        code = "\n".join([PRELUDE, *(f"#define {name} {value}" for name, value in sizes.items()), body, LOOP])
        level = "-O1" if n_distinct_instructions(function) > LARGE else "-O3"
        library = compiled_library(code, (*OPTIONS, level, f"-DLANES={lanes}"))
        self._run = ctypes.CDLL(str(library)).run
        self._run.argtypes = [ctypes.c_long, ctypes.c_long, *[ctypes.c_void_p] * 8]
        self._run.restype = None
        self._constants = np.array(constants.values)

    def run(
        self, periods: int, measured: int, state: Array, shared: Array, own: Array, parameters: Array
    ) -> LaneResult:
        """Run all lanes over the periods.

        Parameters
        ----------
        periods, measured
            Number of periods, and the one at which measuring begins.
        state
            At the start, (states, lanes).
        shared
            Inputs that all runs share, (periods, numbers).
        own
            Those of each run, (periods, numbers, lanes).
        parameters
            Those that do not change, (numbers, lanes).
        """
        expected = {
            "state": (state, (self._n_state, self.lanes)),
            "shared": (shared, (periods, self._counts[SHARED])),
            "own": (own, (periods, self._counts[OWN], self.lanes)),
            "parameters": (parameters, (self._counts[PARAMETER], self.lanes)),
        }
        for name, (array, shape) in expected.items():
            if array.shape != shape:
                raise InvalidParameter(f"{name}: got shape {array.shape}; needs {shape}")
        now, next_state = aligned(state.shape), aligned(state.shape)
        now[:] = state
        record = aligned((periods, self._n_record, self.lanes))
        ends = np.full(self.lanes, -1, dtype=np.int64)
        shared = np.ascontiguousarray(shared, dtype=float)
        own, parameters = _as_aligned(own), _as_aligned(parameters)
        arrays = now, next_state, shared, own, parameters, record, ends, self._constants
        self._run(periods, measured, *(array.ctypes.data for array in arrays))
        return LaneResult(now, record, ends)


def aligned(shape: tuple[int, ...]) -> Array:
    """Return an array, not initialised, that begins where vectors of the processor may."""
    size = int(np.prod(shape))
    raw = np.empty(size + ALIGNMENT // 8)
    start = -raw.ctypes.data % ALIGNMENT // 8
    return raw[start : start + size].reshape(shape)


def _as_aligned(array: Array) -> Array:
    """Return the array itself, or a copy that begins where vectors of the processor may."""
    if array.flags.c_contiguous and array.dtype == float and array.ctypes.data % ALIGNMENT == 0:
        return array
    copy = aligned(array.shape)
    copy[:] = array
    return copy


@cache
def processor_lanes() -> int:
    """Return how many runs fit into a vector of this processor: 8 with AVX-512, 4 with AVX2, else 2."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return 2
    flags = {word for line in text.splitlines() if line.startswith("flags") for word in line.split()}
    if {"avx512f", "avx512dq"} <= flags:
        return 8
    return 4 if "avx2" in flags else 2
