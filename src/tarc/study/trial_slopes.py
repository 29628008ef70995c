"""The linearised loop of trials that differ in their gains alone, traced once for all of them."""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels, parametric_channel
from tarc.control.digital_controller import ControllerInput, DigitalController
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.core.tracing import TRACE_ERRORS
from tarc.core.types import Array
from tarc.laws.pole_placement import PolePlacement
from tarc.signals.sensors import Encoder
from tarc.simulation.varying import Numbers, Path, differing, numbers_at, replaced, with_symbols

COMPARED_RATIOS = (0.01, 0.1, 1.0)
"""Inertia ratios at which the loop is compared with that of the law itself."""
AGREEMENT = 1e-7
"""Largest difference of the spectral radii there."""


class SharedSlopes:
    """Linearises laws of one kind, whose joints share a loop, by one function of their numbers.

    Parameters
    ----------
    examples
        Laws whose gains differ in all that may differ.

    Raises
    ------
    UnsupportedLaw
        For laws of different structure, a law that is traced with numbers alone, and one whose numbers enter what is
        computed when it is built.
    NotLinearisable
        For a law that has no linearisation at rest.
    """

    def __init__(self, examples: Sequence[PolePlacement]):
        singles = [_single_joint(law) for law in examples]
        for law in singles:
            _step_once(law)  # so that all have computed what they keep
        self._base = singles[0]
        self._numbers = Numbers(self._base)
        others = [Numbers(law) for law in singles]
        if any(other.structure != self._numbers.structure for other in others):
            raise UnsupportedLaw("slopes: the laws differ in more than numbers")
        self._masks = differing(others)
        self._channel = self._traced()
        for law, numbers in zip(examples, others, strict=True):
            interpolated = self._channel(self._values(numbers))
            (true,) = decoupled_channels(law)
            radii = [[_radius(loop, ratio) for ratio in COMPARED_RATIOS] for loop in (interpolated, true)]
            if not np.allclose(*radii, rtol=0, atol=AGREEMENT):
                raise UnsupportedLaw("slopes: one of the numbers enters what is computed when a law is built")

    def channel(self, law: PolePlacement) -> Channel | None:
        """Return the loop of a law without computation delay; None where it differs in more than the examples do."""
        single = _single_joint(law)
        if type(single.estimator) is not type(self._base.estimator):
            return None
        _compute_alike(single, self._base)
        numbers = Numbers(single)
        if numbers.structure != self._numbers.structure:
            return None
        for path, value in self._numbers.values.items():
            same = np.equal(value, numbers.values[path]) | self._masks.get(path, np.zeros(value.shape, dtype=bool))
            if not np.all(same):
                return None
        return self._channel(self._values(numbers))

    def _values(self, numbers: Numbers) -> Array:
        parts = [numbers_at(numbers.values[path], mask) for path, mask in self._masks.items()]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _traced(self) -> Callable[[Array], Channel]:
        parameters = ca.SX.sym("p", sum(int(np.sum(mask)) for mask in self._masks.values()))
        symbols: dict[Path, object] = {}
        start = 0
        for path, mask in self._masks.items():
            stop = start + int(np.sum(mask))
            symbols[path] = with_symbols(self._numbers.values[path], mask, parameters[start:stop])
            start = stop
        try:
            return parametric_channel(self._base, replaced(self._base, symbols), parameters)
        except NotLinearisable:
            raise
        except TRACE_ERRORS as error:
            raise UnsupportedLaw(f"slopes: the law decides by its numbers ({error})") from None


def _single_joint(law: PolePlacement) -> PolePlacement:
    """Return the loop of one joint, as `decoupled_channels` takes it."""
    return law.single_joint(float(law.K1[0, 0]), float(law.K2[0, 0]), None).without_model()


def _step_once(law: PolePlacement) -> None:
    controller, zero = DigitalController(Encoder(), law), np.zeros(1)
    controller.step(controller.init(zero), ControllerInput(*[zero] * 6))


def _compute_alike(law: PolePlacement, like: PolePlacement) -> None:
    """Let a law compute what another one has computed."""
    for part, other in ((law, like), (law.estimator, like.estimator)):
        for name in vars(other):
            getattr(part, name)


def _radius(loop: Channel, ratio: float) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(loop.state_matrix(ratio)))))
