"""The trajectory trackers, one law a file: pure functions with explicit memory, compiled with the plant they drive."""
