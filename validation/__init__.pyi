from . import calibrate as calibrate
from . import compare as compare
from . import fit as fit
from . import replicate as replicate
from . import track as track
from . import tune as tune
from .experiment.sources import open_source as open_source
from .plants.profile import load_profile as load_profile
from .simulator.description import load_robot as load_robot
from .study.sweep import sweep as sweep

__all__ = [
    *("calibrate", "compare", "fit", "replicate", "track", "tune"),
    *("load_profile", "load_robot", "open_source", "sweep"),
]
