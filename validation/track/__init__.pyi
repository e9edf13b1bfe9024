from .data import TrackedRobot as TrackedRobot
from .gains import GainSet as GainSet
from .gains import load_gains as load_gains
from .loops import ClosedLoopRobot as ClosedLoopRobot
from .loops import make_controller as make_controller
from .loops import make_robot as make_robot
from .loops import run_robots as run_robots
from .result import TrackResult as TrackResult
from .run import TrackSettings as TrackSettings
from .run import chosen_controller as chosen_controller
from .run import track as track
from .waypoint_files import open_reference as open_reference

__all__ = [
    "ClosedLoopRobot",
    "GainSet",
    "TrackResult",
    "TrackSettings",
    "TrackedRobot",
    "chosen_controller",
    "load_gains",
    "make_controller",
    "make_robot",
    "open_reference",
    "run_robots",
    "track",
]
