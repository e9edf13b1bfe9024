"""Studies: questions that take many runs to answer. Each has a file here and a line in `validation.study.catalogue`.

From Python: `from validation.study.contact import study_contact`; on the command line: `python -m validation.study contact`.
"""
