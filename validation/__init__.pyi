from . import calibrate as calibrate
from . import compare as compare
from . import fit as fit
from . import track as track
from . import tune as tune
from .experiment.sources import open_source as open_source
from .plants.profile import load_profile as load_profile
from .simulator.description import load_robot as load_robot
from .sweep import sweep as sweep

__all__ = [
    *("calibrate", "compare", "fit", "track", "tune"),
    *("load_profile", "load_robot", "open_source", "sweep"),
]
