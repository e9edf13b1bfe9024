from .cost import TuneCost as TuneCost
from .data import TunedRun as TunedRun
from .options import TuneParameters as TuneParameters
from .options import TuneTask as TuneTask
from .result import TuneResult as TuneResult
from .run import tune as tune

__all__ = ["TuneCost", "TuneParameters", "TuneResult", "TuneTask", "TunedRun", "tune"]
