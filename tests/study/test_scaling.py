"""A law in units of another period and position does the same on a robot that is as much slower and larger."""

import numpy as np
import pytest

from tarc import Scenario
from tarc.study import tuned_laws
from tarc.study.scaling import rescale

RATIO = 50.0
POSITION = 100.0
MODEL_FREE = [name for name, part in tuned_laws().items() if "model" not in part | part.get("inertia", {})]


def run(law, ratio, position):
    """Two masses on springs whose time unit is longer by a ratio, and whose positions are larger by another."""
    content = {
        "robot": {
            "kind": "MassSpringDamper",
            "masses": [4.0, 3.0],
            "springs": [1500.0 / ratio**2, 800.0 / ratio**2],
            "dampers": [4.0 / ratio, 8.0 / ratio],
        },
        "law": law,
        "estimator": {"kind": "Algebraic", "window": 0.010 * ratio},
        "reference": {
            "kind": "Sinusoid",
            "amplitude": [0.02 * position, 0.03 * position],
            "frequency": [3.0 / ratio, 5.0 / ratio],
        },
        "sensor": {"noise": 1e-5 * position},
        "duration": 0.4 * ratio,
        "period": 1e-3 * ratio,
        "substeps": 2,
        "native": False,
        "divergence_threshold": 5.0 * position,
    }
    (result,) = Scenario.parse(content).run(progress=False).values()
    return result.data


@pytest.mark.parametrize("name", MODEL_FREE)
def test_a_law_does_the_same_in_units_of_its_period(name):
    law = tuned_laws()[name]
    fast = run(law, 1.0, 1.0)
    slow = run(rescale(law, 1e-3, 1e-3 * RATIO, POSITION), RATIO, POSITION)
    if name == "tdc-differentiator":  # its signs amplify rounding tenfold in every 20 periods
        fast, slow = fast.isel(time=slice(100)), slow.isel(time=slice(100))
    assert fast.sizes == slow.sizes
    # ASMC's least gain has one number for two units, as its source prints it
    tolerance = 1e-5 if name.startswith("asmc") else 1e-9
    assert np.allclose(slow["position"] / POSITION, fast["position"], rtol=0, atol=tolerance * 0.03)
    assert np.allclose(slow["torque"] * RATIO**2 / POSITION, fast["torque"], rtol=0, atol=1e4 * tolerance)


def test_its_own_period_changes_nothing():
    for law in tuned_laws().values():
        assert rescale(law, 1e-3, 1e-3) == law
