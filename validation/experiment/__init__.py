"""Sources, references, gains, controllers, and robots in open and closed loops."""
