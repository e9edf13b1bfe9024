"""Questions that take many runs, one folder each."""
