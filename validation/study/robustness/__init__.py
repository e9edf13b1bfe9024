"""Robustness: trackers drive MuJoCo Huskies that differ from the robot of their profile.

`from validation.study.robustness import RobustnessOptions, study_robustness`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
