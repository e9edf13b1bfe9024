"""Find a plant's parameters from a motion."""
