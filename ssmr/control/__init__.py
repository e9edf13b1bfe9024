"""Trajectory tracking: references, control laws, and the closed loop around a planar model."""
