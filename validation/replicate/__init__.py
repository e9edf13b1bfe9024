"""Replication: every result of the thesis beside ours, with a verdict for each row."""

from validation.replicate.run import replicate as replicate
