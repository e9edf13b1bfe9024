from .evidence import QUICK_SETTINGS as QUICK_SETTINGS
from .evidence import ReplicationSettings as ReplicationSettings
from .result import Replication as Replication
from .run import replicate as replicate

__all__ = ["QUICK_SETTINGS", "Replication", "ReplicationSettings", "replicate"]
