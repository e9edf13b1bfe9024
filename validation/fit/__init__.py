"""Find a plant's parameters from motions: `fit`, and the search that it shares with the tuning of controllers."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
