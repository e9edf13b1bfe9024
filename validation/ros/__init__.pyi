from .control import Control as Control
from .control import control as control
from .simulation import Sim as Sim
from .simulation import sim as sim

__all__ = ["Control", "Sim", "control", "sim"]
