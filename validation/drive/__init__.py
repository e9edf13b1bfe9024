"""Drive a robot by hand: `drive_by_hand` on what `prepare_drive` makes."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
