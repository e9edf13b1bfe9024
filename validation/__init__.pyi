from .motion.sources import open_source as open_source
from .plants.profile import load_profile as load_profile

__all__ = ["load_profile", "open_source"]
