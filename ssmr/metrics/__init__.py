"""Measures of how far one motion lies from another."""
