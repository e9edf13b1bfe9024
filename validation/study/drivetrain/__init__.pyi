from .result import DriveTrainOptions as DriveTrainOptions
from .result import DriveTrainStudy as DriveTrainStudy
from .run import study_drivetrain as study_drivetrain

__all__ = ["DriveTrainOptions", "DriveTrainStudy", "study_drivetrain"]
