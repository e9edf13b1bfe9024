"""The planar models of the robot, one a file."""
