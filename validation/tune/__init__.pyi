from .cost import TuneCost as TuneCost
from .data import TunedRun as TunedRun
from .result import TuneResult as TuneResult
from .run import TuneParameters as TuneParameters
from .run import TuneTask as TuneTask
from .run import tune as tune

__all__ = ["TuneCost", "TuneParameters", "TuneResult", "TuneTask", "TunedRun", "tune"]
