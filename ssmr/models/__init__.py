"""The planar models of the robot, one file each, and the friction laws that they use."""
