"""Motions: sources of commands and recorded poses, and plants that are driven along them."""
