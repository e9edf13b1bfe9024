"""The MuJoCo robot, recordings, profiles, programs and pictures, around the models of `ssmr`."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
