"""The drive train: what a real robot's driver, friction, losses and inertia are, from commands, wheel rates and currents.

`from validation.study.drivetrain import DriveTrainOptions, study_drivetrain`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
