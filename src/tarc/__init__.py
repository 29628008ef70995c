"""Robot tracking from position measurements alone: time-delayed adaptive robust control.

``tarc.laws``, ``tarc.estimators``, ``tarc.plants``, ``tarc.signals`` hold the parts; `simulate` runs them, and
`Controller` runs a law on a robot of your own.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
