"""The fault campaign, `python -m tests.faults`: what users, files, machines and other people do wrong, by the ten thousand.

A case is a part, a kind and a number; with the seed, these three decide everything about it, so that any case can be
repeated by itself. Whatever a case does, one function judges it: `tests.faults.judge.judge`.
"""
