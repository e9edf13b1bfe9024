"""Mathematics of skid-steering robots: models, controllers, state filter, metrics and search.

Numbers in, numbers out: nothing here reads a file, draws or prints. Names are imported when they
are first used.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
