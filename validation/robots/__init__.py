"""Robots as data: list those that come with the package, check one, and draft the file of a new one."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
