from .result import GainsOptions as GainsOptions
from .result import GainStudy as GainStudy
from .run import study_gains as study_gains

__all__ = ["GainStudy", "GainsOptions", "study_gains"]
