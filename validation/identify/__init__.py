"""Parts that a fit and a tuning share: problems, the search, least squares, uncertainty, and how a search is reported."""
