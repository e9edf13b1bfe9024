"""Parameter spaces and the optimisers that search them."""
