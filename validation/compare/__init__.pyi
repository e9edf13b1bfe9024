from .data import PlantResult as PlantResult
from .result import Comparison as Comparison
from .run import CompareSettings as CompareSettings
from .run import compare as compare

__all__ = ["CompareSettings", "Comparison", "PlantResult", "compare"]
