from .filtering import HighPass as HighPass
from .result import NoiseOptions as NoiseOptions
from .result import NoiseStudy as NoiseStudy
from .run import study_noise as study_noise

__all__ = ["HighPass", "NoiseOptions", "NoiseStudy", "study_noise"]
