"""Terrain: planar models and trackers as speed, slope, roughness and loss of grip grow.

`from validation.study.terrain import TerrainOptions, study_terrain`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
