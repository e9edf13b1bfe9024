"""The robot as numbers: geometry, drive, sensors, wheel loads, ground."""
