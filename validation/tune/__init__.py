"""Tune a controller's gains."""
