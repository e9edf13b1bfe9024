"""Drive every plant with the same commands and compare each with one reference: `compare`."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
