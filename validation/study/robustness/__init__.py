"""Controllers on robots that differ from the one they were tuned for."""
