from .data import FittedParameter as FittedParameter
from .objective import FitCost as FitCost
from .result import FitResult as FitResult
from .run import FitParameters as FitParameters
from .run import FitSearch as FitSearch
from .run import fit as fit
from .targets import FitSources as FitSources

__all__ = ["FitCost", "FitParameters", "FitResult", "FitSearch", "FitSources", "FittedParameter", "fit"]
