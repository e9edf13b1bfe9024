"""State estimation from wheel encoders and a gyro."""
