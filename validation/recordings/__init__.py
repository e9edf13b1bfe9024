"""Look into a log, and convert it."""
