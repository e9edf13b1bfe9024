"""Engines: the same robot in MuJoCo, ODE and Drake, each with several settings, against closed forms and recordings.

`from validation.study.engines import EnginesOptions, study_engines`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
