from .batch import TrackBatch as TrackBatch
from .entity import RobotEntity as RobotEntity
from .entity import ground as ground
from .environment import Tracking as Tracking
from .environment import tracking as tracking
from .episodes import TrackTask as TrackTask
from .gym import TrackEnv as TrackEnv
from .gym import TrackVectorEnv as TrackVectorEnv

__all__ = ["RobotEntity", "TrackBatch", "TrackEnv", "TrackTask", "TrackVectorEnv", "Tracking", "ground", "tracking"]
