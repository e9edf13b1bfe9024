from .environment import RobotEntity as RobotEntity
from .environment import Tracking as Tracking
from .environment import ground as ground
from .environment import tracking as tracking

__all__ = ["RobotEntity", "Tracking", "ground", "tracking"]
