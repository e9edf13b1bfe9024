"""The robot on four tyres as a plant, with the numbers of its file."""

from __future__ import annotations

from functools import partial

from ssmr.models.four_wheel import FourWheelParameters
from ssmr.models.four_wheel_plant import FourWheelModel, FourWheelPlant, run_four_wheels
from validation.plants.kind import PlantKind, PlantProfile
from validation.plants.planar import PlanarPopulation
from validation.simulator.description import Robot
from validation.simulator.physics import PhysicsSettings
from validation.simulator.terrain import Terrain

_TYRES = ("stiffness_x", "stiffness_y")


def tyred_defaults(robot: Robot) -> FourWheelParameters:
    """Return the numbers of a robot's file; those of the tyres, which no file has, are of the drive-train study."""
    geometry, masses, simulation = robot.geometry, robot.masses, robot.simulation
    share = robot.base_mass / masses.total
    return FourWheelParameters(
        mass=masses.total,
        yaw_inertia=robot.yaw_inertia,
        wheelbase=geometry.wheelbase,
        half_track=0.5 * geometry.track,
        wheel_radius=geometry.wheel_radius,
        com_x=share * masses.com[0],
        com_y=share * masses.com[1],
        com_height=geometry.wheel_radius + share * (masses.com[2] - geometry.axle_height),
        gain=simulation.gain,
        armature=simulation.armature,
        wheel_inertia=masses.wheel_inertia[1],
        link=geometry.link,
        friction=simulation.friction,
    )


def _model(section: PlantProfile) -> FourWheelModel:
    return FourWheelModel(section.parameters, section.drive)


def _build(section: PlantProfile, terrain: Terrain, settings: PhysicsSettings) -> FourWheelPlant:
    """Return the plant; it knows only level ground of one friction, and no physics settings."""
    return FourWheelPlant(_model(section))


KIND = PlantKind(
    "four_wheel",
    FourWheelParameters,
    tyred_defaults,
    _build,
    partial(PlanarPopulation, make=_model, run=run_four_wheels),
    free={
        "scenario": (*_TYRES, "wheel_radius", "command_half_track", "delay", "acceleration_v"),
        "recording": (
            *("friction", *_TYRES, "wheel_radius", "radius_difference", "com_x", "com_y"),
            *("delay", "acceleration_v", "acceleration_w", "wheel_lag", "tracked_x", "tracked_y"),
        ),
    },
    colour="#56b4e9",
)
