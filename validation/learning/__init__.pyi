from .environment import Husky as Husky
from .environment import Tracking as Tracking
from .environment import ground as ground
from .environment import tracking as tracking

__all__ = ["Husky", "Tracking", "ground", "tracking"]
