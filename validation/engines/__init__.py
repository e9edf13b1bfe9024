"""Other engines that drive the same robot: ODE, Gazebo's engine, and Drake. Each is a `Plant` of MuJoCo's numbers."""
