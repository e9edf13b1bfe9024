"""Timings beside peers; one command each."""
