"""Robots to control: from energies by differentiation, or from MJCF and URDF files."""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
