from .findings import TerrainAxes as TerrainAxes
from .findings import TerrainOptions as TerrainOptions
from .result import TerrainStudy as TerrainStudy
from .run import study_terrain as study_terrain

__all__ = ["TerrainAxes", "TerrainOptions", "TerrainStudy", "study_terrain"]
