from .run import control_robot as control_robot
from .run import simulate_robot as simulate_robot

__all__ = ["control_robot", "simulate_robot"]
