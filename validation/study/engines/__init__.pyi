from .result import EnginesStudy as EnginesStudy
from .run import EnginesOptions as EnginesOptions
from .run import study_engines as study_engines

__all__ = ["EnginesOptions", "EnginesStudy", "study_engines"]
