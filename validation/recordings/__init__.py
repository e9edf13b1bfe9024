"""Look into a log of a robot, and convert it: `info` and `convert`."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
