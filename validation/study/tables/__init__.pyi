from .findings import TablesOptions as TablesOptions
from .result import ControlTables as ControlTables
from .run import study_tables as study_tables

__all__ = ["ControlTables", "TablesOptions", "study_tables"]
