"""Everything around the mathematics of `ssmr`: the MuJoCo robot, recordings, profiles, programs and pictures."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
