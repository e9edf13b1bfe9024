"""Parts that fits and tunings share: problems, search, least squares, uncertainty and report."""
