from .control.laws import CONTROLLERS as CONTROLLERS
from .control.laws import Controller as Controller
from .control.laws import make_gains as make_gains
from .control.loop import ClosedRun as ClosedRun
from .control.loop import LoopSettings as LoopSettings
from .control.loop import LostError as LostError
from .control.loop import run_loop as run_loop
from .control.lqr import LqrGains as LqrGains
from .control.lqr import ScheduledGains as ScheduledGains
from .control.pid import PidGains as PidGains
from .control.population import run_loops as run_loops
from .control.references import circle as circle
from .control.references import eight as eight
from .control.references import line as line
from .control.references import sine as sine
from .control.references import spiral as spiral
from .control.references import square as square
from .control.references import stop_and_go as stop_and_go
from .control.references import u_turn as u_turn
from .control.waypoints import Waypoints as Waypoints
from .errors import DivergedError as DivergedError
from .errors import SsmrError as SsmrError
from .estimation.ekf import run_ekf as run_ekf
from .estimation.settings import EkfSettings as EkfSettings
from .lanes import run_population as run_population
from .metrics.declared import Metrics as Metrics
from .metrics.declared import compare_paths as compare_paths
from .metrics.windows import HorizonErrors as HorizonErrors
from .metrics.windows import horizon_errors as horizon_errors
from .metrics.windows import relative_pose_error as relative_pose_error
from .models.coulomb import CoulombParameters as CoulombParameters
from .models.improved import ImprovedParameters as ImprovedParameters
from .models.kinematic import KinematicParameters as KinematicParameters
from .models.law import PLANAR_MODELS as PLANAR_MODELS
from .models.linear import LinearParameters as LinearParameters
from .robot.sensors import SensorNoise as SensorNoise
from .robot.sensors import measure as measure
from .robot.sensors import yaw_disturbance as yaw_disturbance
from .robot.vehicle import Drive as Drive
from .robot.vehicle import Vehicle as Vehicle
from .scenarios import TRAJECTORIES as TRAJECTORIES
from .scenarios import SineScenario as SineScenario
from .search.jde import Jde as Jde
from .search.jde import JdeSettings as JdeSettings
from .search.space import Parameter as Parameter
from .search.space import ParameterSpace as ParameterSpace
from .simulation import PlanarModel as PlanarModel
from .simulation import PlanarPlant as PlanarPlant
from .types import Commands as Commands
from .types import Plant as Plant
from .types import State as State
from .types import Trajectory as Trajectory

__all__ = [
    "CONTROLLERS",
    "PLANAR_MODELS",
    "TRAJECTORIES",
    "ClosedRun",
    "Commands",
    "Controller",
    "CoulombParameters",
    "DivergedError",
    "Drive",
    "EkfSettings",
    "HorizonErrors",
    "ImprovedParameters",
    "Jde",
    "JdeSettings",
    "KinematicParameters",
    "LinearParameters",
    "LoopSettings",
    "LostError",
    "LqrGains",
    "Metrics",
    "Parameter",
    "ParameterSpace",
    "PidGains",
    "PlanarModel",
    "PlanarPlant",
    "Plant",
    "ScheduledGains",
    "SensorNoise",
    "SineScenario",
    "SsmrError",
    "State",
    "Trajectory",
    "Vehicle",
    "Waypoints",
    "circle",
    "compare_paths",
    "eight",
    "horizon_errors",
    "line",
    "make_gains",
    "measure",
    "relative_pose_error",
    "run_ekf",
    "run_loop",
    "run_loops",
    "run_population",
    "sine",
    "spiral",
    "square",
    "stop_and_go",
    "u_turn",
    "yaw_disturbance",
]
