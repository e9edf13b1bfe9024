from .advice import Advice as Advice
from .drafting import TapeMeasure as TapeMeasure
from .drafting import draft_from_tape as draft_from_tape
from .importing import import_robot as import_robot
from .result import DraftedRobot as DraftedRobot
from .result import RobotCheck as RobotCheck
from .result import RobotList as RobotList
from .run import check_robot as check_robot
from .run import export_robot as export_robot
from .run import list_robots as list_robots

__all__ = [
    "Advice",
    "DraftedRobot",
    "RobotCheck",
    "RobotList",
    "TapeMeasure",
    "check_robot",
    "draft_from_tape",
    "export_robot",
    "import_robot",
    "list_robots",
]
