"""Tracking: closed loops around any plant, compared with the reference that they follow."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
