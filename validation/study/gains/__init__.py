"""Gains: every shipped set of gains on every named reference, at both of the thesis' speeds.

`from validation.study.gains import GainsOptions, study_gains`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
