from .calibrate import calibrate as calibrate
from .compare import compare as compare
from .descriptions.loading import load_robot as load_robot
from .experiment.sources import open_source as open_source
from .fit import fit as fit
from .plants.profile import load_profile as load_profile
from .sweep import sweep as sweep
from .track import track as track
from .tune import tune as tune

__all__ = [
    *("calibrate", "compare", "fit", "track", "tune"),
    *("load_profile", "load_robot", "open_source", "sweep"),
]
