"""What ``help`` and notebooks show of a component."""

import inspect

import tarc


def test_the_signature_is_that_of_the_dataclass():
    signature = inspect.signature(tarc.laws.TDC)
    assert list(signature.parameters)[:2] == ["period", "estimator"]
    assert signature.parameters["damping_ratio"].default == 1.0
    assert all(parameter.kind is inspect.Parameter.KEYWORD_ONLY for parameter in signature.parameters.values())
