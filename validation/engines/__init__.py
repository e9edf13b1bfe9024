"""Other engines that drive the same robot as a `Plant`: ODE, Gazebo's engine, and Drake."""
