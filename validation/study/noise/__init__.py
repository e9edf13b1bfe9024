"""The study of noise: what is left of a log's signals above 10 Hz (Sec. 3.4.4).

`from validation.study.noise import NoiseOptions, study_noise`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
