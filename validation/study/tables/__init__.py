"""Tables: the thesis' tables of tracked references (Tab. 4.5-4.36), printed beside what this project gets.

`from validation.study.tables import TablesOptions, study_tables`
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
