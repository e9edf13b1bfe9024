"""The study of dead reckoning: how fast the state filter's pose drifts, by ground and by sensors."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
