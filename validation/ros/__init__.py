"""The MuJoCo Husky and the controllers on a ROS graph."""
