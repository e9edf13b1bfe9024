from .cases import RobustnessOptions as RobustnessOptions
from .result import Robustness as Robustness
from .run import study_robustness as study_robustness

__all__ = ["Robustness", "RobustnessOptions", "study_robustness"]
