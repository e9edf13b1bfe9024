"""Replication: every result of the thesis beside what this project gets, with a verdict for each row."""

from validation.replicate.run import replicate as replicate
