from .result import ConvertedLog as ConvertedLog
from .result import LogInfo as LogInfo
from .run import ConvertSettings as ConvertSettings
from .run import convert as convert
from .run import info as info
from .run import open_log as open_log

__all__ = ["ConvertSettings", "ConvertedLog", "LogInfo", "convert", "info", "open_log"]
