"""The thesis' printed numbers, and how ours are judged against them."""
