"""Parameters that stay changeable in C give the law that is built with them; others are refused with a reason."""

from dataclasses import fields, replace

import numpy as np
import pytest

import tarc
from law_catalogue import concrete_laws, make_law
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.export.traced_law import traced_law
from tarc.export.tunable import SCALE, tunable_law

QUICK = ("TDC",)
SIZES = (1e-3, 0.02, 0.3)


def built_with(law, name, values):
    if name == SCALE:
        return replace(law, inertia=values[0] * np.asarray(law.inertia))
    return replace(law, **{name: values if np.ndim(getattr(law, name)) else float(values[0])})


def outputs(step, state, size, count=60):
    """Return the outputs of random steps of a size."""
    rng, found = np.random.default_rng(3), []
    for _ in range(count):
        state, output = (np.array(part).ravel() for part in step(state, size * rng.standard_normal(8)))
        found.append(output)
    return np.array(found)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind.__name__ in QUICK else pytest.mark.slow, id=kind.__name__)
        for kind in concrete_laws()
    ],
)
def test_a_changed_parameter_gives_the_law_that_is_built_with_it(kind):
    law = make_law(kind, torque_limit=20.0)
    traced = traced_law(law)
    tunable = tunable_law(law, traced)
    assert tunable.tunables
    exported = np.concatenate([one.values for one in tunable.tunables])
    start = np.array(traced.start(np.full(2, 0.1), np.zeros(2))).ravel()
    rng, first = np.random.default_rng(5), 0
    for size in SIZES:
        same = outputs(tunable.traced.step, np.concatenate([start, exported]), size)
        np.testing.assert_array_equal(same, outputs(traced.step, start, size))
    for one in tunable.tunables:
        values, least = exported.copy(), np.array(one.least)
        new = least * (np.array(one.greatest) / least) ** rng.uniform(0.1, 0.9)
        values[first : first + len(new)] = new
        first += len(new)
        expected = tarc.Controller(built_with(law, one.name, new)).function
        for size in SIZES:
            found = outputs(tunable.traced.step, np.concatenate([start, values]), size)
            wanted = outputs(expected, start, size)
            np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-8, err_msg=one.name)


def test_what_cannot_change_says_why():
    law = make_law(tarc.laws.TARC)
    refused = tunable_law(law, traced_law(law)).refused
    assert refused["inertia"] == "it is a matrix, which inertia_scale may scale"
    assert refused["min_gain"] == "it also sets the state at the start"
    assert set(refused) <= {field.name for field in fields(law)}
    with pytest.raises(UnsupportedLaw, match="min_gain of TARC cannot stay changeable: it also sets the state"):
        tunable_law(law, traced_law(law), ["min_gain"])
    with pytest.raises(InvalidParameter, match="tunable: got 'period'; TARC has the numbers "):
        tunable_law(law, traced_law(law), ["period"])


def test_what_protects_the_robot_is_only_lowered():
    law = make_law(tarc.laws.TDC, torque_limit=20.0)
    ranges = {one.name: one for one in tunable_law(law, traced_law(law)).tunables}
    assert ranges["torque_limit"].greatest == (20.0,)
    assert ranges[SCALE].greatest == (1.0,)
    assert ranges["natural_frequency"].greatest == (120.0,)
