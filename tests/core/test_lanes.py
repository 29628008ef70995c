"""Elementary functions of lanes: near the truth, and the same bits at every width."""

import ctypes

import numpy as np
import pytest

from tarc.core.codegen import compiled_library
from tarc.core.lane_loop import OPTIONS, aligned
from tarc.core.lanes import PRELUDE

FUNCTIONS = {"sin": 0.8, "cos": 0.8, "exp": 0.9, "tanh": 1.3, "log": 0.8}
"""Largest error of each function of our own [ulp]."""
WIDTHS = (1, 2, 4, 8)
CALLED = [*(f"own_{name}" for name in FUNCTIONS), "each_sqrt", "each_floor", "each_ceil"]
SPECIAL = np.array(
    [0, -0.0, np.inf, -np.inf, np.nan, 5e-324, -1e308, 1e-310, 1, -1, 709.7, 710.5, -745, -750, 1e7, 22.1]
)


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        loops = [
            f"void {name}_of(long n, const REAL *x, REAL *y);\n"
            f"void {name}_of(long n, const REAL *x, REAL *y) {{ for (long i = 0; i < n; ++i) y[i] = {name}(x[i]); }}"
            for name in CALLED
        ]
        code = "\n".join([PRELUDE, *loops])
        return {n: ctypes.CDLL(str(compiled_library(code, (*OPTIONS, f"-DLANES={n}")))) for n in WIDTHS}


def call(libraries, lanes, name, values):
    function = libraries[lanes][f"{name}_of"]
    function.argtypes = [ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    x, y = aligned(values.shape), aligned(values.shape)
    x[:] = values
    function(len(values) // lanes, x.ctypes.data, y.ctypes.data)
    return y


def arguments(name):
    """Values over the whole range of a function, a multiple of eight."""
    rng = np.random.default_rng(0)
    tiny = 10.0 ** rng.uniform(-300, 0, 4000)
    parts = {
        "sin": [rng.uniform(-10, 10, 8000), rng.uniform(-1e6, 1e6, 8000), tiny, np.round(tiny * 6e5) * np.pi / 2],
        "exp": [rng.uniform(-745, 709, 8000), rng.uniform(-1, 1, 8000), -tiny],
        "tanh": [rng.uniform(-3, 3, 8000), rng.uniform(-25, 25, 8000), tiny, rng.uniform(0.6, 0.65, 4000)],
        "log": [rng.uniform(0.5, 2, 8000), 10.0 ** rng.uniform(-300, 300, 8000), 1 + 1e-3 * tiny],
    }
    return np.concatenate(parts["sin" if name == "cos" else name])


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="no longer numbers to compare with")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_near_the_truth(libraries, name):
    """Against the library's function in extended precision."""
    x = arguments(name)
    truth = getattr(np, name)(x.astype(np.longdouble))
    error = np.abs(call(libraries, 1, f"own_{name}", x) - truth) / np.spacing(np.abs(truth.astype(float)))
    assert np.max(error) < FUNCTIONS[name]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_special_values(libraries, name):
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(SPECIAL)
    np.testing.assert_allclose(call(libraries, 1, f"own_{name}", SPECIAL), expected, rtol=3e-16, atol=5e-324)


@pytest.mark.parametrize("name", CALLED)
def test_every_width_has_the_same_bits(libraries, name):
    plain = name.removeprefix("own_")
    x = np.concatenate([arguments(plain if plain in FUNCTIONS else "sin"), SPECIAL])
    expected = call(libraries, 1, name, x)
    for lanes in WIDTHS[1:]:
        np.testing.assert_array_equal(call(libraries, lanes, name, x), expected)
