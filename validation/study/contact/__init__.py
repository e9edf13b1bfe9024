"""Contact: MuJoCo's physics settings, one at a time and together, and their effect on the simulated robot.

`from validation.study.contact import ContactOptions, study_contact`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
