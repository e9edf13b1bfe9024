from .result import ContactStudy as ContactStudy
from .run import ContactOptions as ContactOptions
from .run import study_contact as study_contact

__all__ = ["ContactOptions", "ContactStudy", "study_contact"]
