from .findings import FilterOptions as FilterOptions
from .result import FilterStudy as FilterStudy
from .run import study_filter as study_filter

__all__ = ["FilterOptions", "FilterStudy", "study_filter"]
