from .result import ControlTables as ControlTables
from .result import TablesOptions as TablesOptions
from .run import study_tables as study_tables

__all__ = ["ControlTables", "TablesOptions", "study_tables"]
