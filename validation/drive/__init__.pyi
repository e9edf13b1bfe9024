from .run import HandDrive as HandDrive
from .run import drive_by_hand as drive_by_hand
from .run import prepare_drive as prepare_drive

__all__ = ["HandDrive", "drive_by_hand", "prepare_drive"]
