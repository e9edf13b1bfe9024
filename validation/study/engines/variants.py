"""The engines' settings that the study tries: their own, those of Gazebo's Husky, and the best that were found.

Gazebo's Husky: cylinders with mu1 = mu2 = 1, kp = 1e7 N/m, kd = 1 N s/m and fdir1 = (1, 0, 0) are of the maker's package
husky_description (urdf/wheel.urdf.xacro), as is its centre of mass (urdf/husky.urdf.xacro). How they reach ODE is in
Gazebo's gazebo/physics/ode/ODEPhysics.cc: kp of both bodies in series (the ground's is 1e12), kd of both added (the
ground's is 1), ERP = h kp / (h kp + kd), CFM = 1 / (h kp + kd), and fdir1 turned by the pose of the wheel's collision
shape, so that it rolls with the wheel. The world has Gazebo's defaults: dWorldQuickStep, 50 sweeps, SOR 1.3, ERP 0.2,
CFM 0, a surface layer of 1 mm, at most 100 m/s of correction, steps of 1 ms. Gazebo carries a changed copy of ODE, which
is not run here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ssmr.robot.vehicle import Drive
from ssmr.types import Plant
from validation.engines.drake import DrakeBody, DrakeSettings
from validation.engines.ode import OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.table import SECOND_OPINIONS, STANDARD
from validation.simulator.calibration import Calibration
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.study.contact.variants import MUJOCO_IMPEDANCE

ENGINES = (STANDARD, *SECOND_OPINIONS)
"""Names of the engines that are compared."""


@dataclass(frozen=True)
class EngineVariant:
    """An engine with settings."""

    name: str
    """Name in tables."""
    settings: PhysicsSettings | OdeSettings | DrakeSettings
    """Settings of the engine; their type says which it is."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `Calibration` that change too."""
    scored: bool = False
    """Whether it is driven over recordings."""

    @property
    def group(self) -> str:
        """Name of the engine."""
        kinds = zip((PhysicsSettings, OdeSettings, DrakeSettings), ENGINES, strict=True)
        return next(name for kind, name in kinds if isinstance(self.settings, kind))

    @property
    def key(self) -> str:
        """Engine and name."""
        return f"{self.group}: {self.name}"

    def plant(self, calibration: Calibration, drive: Drive, terrain: Terrain = FLAT, step: float = 1.0) -> Plant:
        """Return the robot, with physics steps of `step` times the variant's.

        Raises:
            ValueError: the engine is missing, or cannot have these numbers.
        """
        changed = replace(calibration, **dict(self.changes))
        changed, s = replace(changed, timestep=step * changed.timestep), self.settings
        if isinstance(s, OdeSettings):
            return EnginePlant(self.group, lambda numbers: OdeBody(numbers, s), changed, drive, terrain)
        if isinstance(s, DrakeSettings):
            return EnginePlant(self.group, lambda numbers: DrakeBody(numbers, s), changed, drive, terrain)
        return MujocoPlant(changed, drive, terrain=terrain, settings=s)


_ODE = OdeSettings("pyramid", "world", "quick", 20, soft=False, cfm=1e-10)
GAZEBO = OdeSettings(
    "pyramid", "wheel", "quick", 50, kp=1e7, kd=2.0, cfm=0.0, surface_layer=1e-3, max_correcting_velocity=100.0
)
"""ODE's settings, as Gazebo and the description of its Husky set them."""
_HUSKY: Mapping[str, Any] = {"wheel_shape": "cylinder", "friction": 1.0, "timestep": 0.001}
MAKERS_HUSKY: Mapping[str, Any] = {**_HUSKY, "com_x": -0.00065, "com_y": -0.085}
"""Fields of `Calibration` in which Gazebo's Husky differs from ours, with their values there."""
_PAIR: Mapping[str, Any] = {"wheel_shape": "cylinder"}
_V = EngineVariant

ENGINE_VARIANTS = (
    _V("as shipped", SHIPPED, scored=True),
    _V("its own defaults", PhysicsSettings("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")),
    _V("its own defaults", _ODE),
    _V("Gazebo's Husky", GAZEBO, MAKERS_HUSKY, True),
    _V("Gazebo's Husky, centre in the middle", GAZEBO, _HUSKY),
    _V("Gazebo's Husky, square along the world", replace(GAZEBO, direction="world"), MAKERS_HUSKY),
    _V("Gazebo's Husky, square along the chassis", replace(GAZEBO, direction="body"), MAKERS_HUSKY),
    _V("Gazebo's Husky, emulated cone", replace(GAZEBO, friction_law="cone"), MAKERS_HUSKY),
    _V("Gazebo's Husky, emulated cone, centred", replace(GAZEBO, friction_law="cone"), _HUSKY),
    _V("best: emulated cone, exact solver", OdeSettings(), scored=True),
    _V("best, cylinders", OdeSettings(), _PAIR),
    _V("best, square along the chassis", OdeSettings("pyramid", "body")),
    _V("best, square along the world", OdeSettings("pyramid", "world")),
    _V("its own defaults", DrakeSettings(stiffness=-1.0, stiction=1e-3)),
    _V("best: lagged, stiction 0.1 mm/s", DrakeSettings(), scored=True),
    _V("best, pairs of spheres", DrakeSettings(), _PAIR),
    _V("similar, stiffness 1e6", DrakeSettings("similar", 1e6)),
    _V("SAP, stiffness 1e6", DrakeSettings("sap", 1e6, relaxation_time=0.0)),
    _V("SAP, stiffness 1e5", DrakeSettings("sap", 1e5, relaxation_time=0.0)),
)
"""Every variant, by engine; what is not said is as in the profile."""


def chosen_engines(engines: tuple[str, ...]) -> tuple[EngineVariant, ...]:
    """Return the variants of some engines, of all if none is named.

    Raises:
        ValueError: there is no such engine.
    """
    if unknown := [name for name in engines if name not in ENGINES]:
        raise ValueError(f"unknown engine '{', '.join(unknown)}' in engines; there are: {', '.join(ENGINES)}")
    return tuple(v for v in ENGINE_VARIANTS if not engines or v.group in engines)
