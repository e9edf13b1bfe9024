"""Transfer: does an analytic model choose the right controller for the MuJoCo robot?

`from validation.study.transfer import TransferOptions, study_transfer`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
