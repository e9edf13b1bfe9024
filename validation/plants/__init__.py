"""Every plant: its parameters, how it is built, and the profiles that hold calibrated numbers."""
