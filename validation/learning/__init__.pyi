from .batch import TrackBatch as TrackBatch
from .entity import RobotEntity as RobotEntity
from .entity import ground as ground
from .environment import Tracking as Tracking
from .environment import tracking as tracking
from .episodes import TrackTask as TrackTask
from .gym import TrackEnv as TrackEnv

__all__ = ["RobotEntity", "TrackBatch", "TrackEnv", "TrackTask", "Tracking", "ground", "tracking"]
