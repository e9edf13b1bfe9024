from .contenders import TransferOptions as TransferOptions
from .result import TransferStudy as TransferStudy
from .run import study_transfer as study_transfer

__all__ = ["TransferOptions", "TransferStudy", "study_transfer"]
