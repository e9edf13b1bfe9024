"""Studies: questions that take many runs to answer.

Each has a file here and its name in `validation.study.__main__`.

From Python: `from validation.study.contact import study_contact`; on the command line: `python -m
validation.study contact`.
"""
