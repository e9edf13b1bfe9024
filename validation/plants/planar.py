"""The planar models as plants, each declared from its law, and the robot on four tyres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ssmr.lanes import run_population
from ssmr.models.four_wheel import FourWheelParameters
from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.models.kinematic import KinematicParameters
from ssmr.models.law import planar_law
from ssmr.parameters import describe_parameters
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import FloatArray
from validation.plants.kind import (
    CAUSES,
    SEEN,
    Free,
    PlantKind,
    PlantProfile,
    Stretch,
    sample_count,
)
from validation.simulator.checking import spot_turn
from validation.simulator.description import Robot

_READ_OFF = ("effective_half_track", "delay", "acceleration_v")
"""Numbers that the thesis read off response curves or took for granted, and a fit to a scenario has
to find."""
_DRIVEN = ("delay", "acceleration_v", "acceleration_w")
"""Numbers of the driver, of which wheel rates say nothing."""
_MOTOR = ("torque_limit", "integral_gain", "dc_stiffness")
"""Numbers of the motors, which a model whose wheels turn exactly as commanded does not have."""
_ROLLING = ("wheel_radius", "radius_difference", "effective_half_track")
"""Numbers that are left of a dynamic model whose wheel rates are given."""
_CENTRES = ("alpha_l", "alpha_r", "y_l", "y_r")
"""Numbers of the kinematic model's centres of rotation."""
_KINEMATIC: Free = {
    "scenario": (*_CENTRES, "x_icr"),
    # x_icr and tracked_x are one number to a recording
    "commands": (*_CENTRES, "drift", *_DRIVEN, "wheel_lag", *SEEN),
    "wheels": (*_CENTRES, "drift", *SEEN),
}
"""The kinematic model has no dynamics that could lag behind its wheels, and its constants hold the
half-track."""
_TYRES = (
    "friction",
    "stiffness_x",
    "stiffness_y",
    "wheel_radius",
    "radius_difference",
    "com_x",
    "com_y",
)
"""Numbers of a body on four tyres."""
_TYRED_FREE: Free = {
    "scenario": CAUSES,
    "commands": (*_TYRES, *_DRIVEN, "wheel_lag", *SEEN),
    "wheels": (*_TYRES, *SEEN),
}


def _model_of(section: PlantProfile) -> PlanarModel:
    """Return the planar model with a profile's numbers."""
    return PlanarModel(section.parameters, section.vehicle, section.drive)


def _default_parameters(kind: type, robot: Robot) -> Any:
    """Return the thesis' parameters of a planar model, scaled to a robot's size.

    Friction and shares stay as they are. Of robots of one shape that do all things in the same
    time, mass times radius squared decides
    the gain between wheel rate and torque, and mass times radius that between speed and torque.
    Centres of rotation lie at the effective half-track.
    """
    thesis = Vehicle()
    vehicle = robot.vehicle
    numbers = kind()
    mass = vehicle.mass / thesis.mass
    radius = vehicle.wheel_radius / thesis.wheel_radius
    # ratios of sizes by their names in declarations
    ratios = {
        "gain": mass * radius**2,
        "gain_over_radius": mass * radius,
        "half_track": vehicle.effective_half_track / thesis.effective_half_track,
    }
    scaled = {}
    for name, declared in describe_parameters(kind).items():
        sizes = [size for size in declared.of if size in ratios]
        if sizes:
            scaled[name] = getattr(numbers, name) * ratios[sizes[0]]
    return replace(numbers, **scaled)


def _kinematic_defaults(robot: Robot) -> KinematicParameters:
    """Return the kinematic model of a robot by mechanics.

    Unless its file says how it turns, its centres of rotation are those of the turn on the spot in
    closed form: the sides' rims move at -1 and 1 m/s, the middle at (forward, across), and
    v - omega y is a side's rim speed at its centre of rotation.
    """
    numbers = _default_parameters(KinematicParameters, robot)
    turn = spot_turn(robot)
    is_given = "vehicle.effective_half_track" in robot.given
    if is_given or turn is None or turn.yaw_rate <= 0.0:
        return numbers
    return replace(
        numbers,
        x_icr=-turn.across / turn.yaw_rate,
        y_l=(1.0 + turn.forward) / turn.yaw_rate,
        y_r=-(1.0 - turn.forward) / turn.yaw_rate,
    )


def tyred_defaults(robot: Robot) -> FourWheelParameters:
    """Return the numbers of a robot's file, with the tyres of the drive-train study."""
    share = robot.base_mass / robot.mass
    return FourWheelParameters(
        mass=robot.mass,
        yaw_inertia=robot.yaw_inertia,
        wheelbase=robot.wheelbase,
        half_track=0.5 * robot.track,
        wheel_radius=robot.wheel_radius,
        com_x=share * robot.com[0],
        com_y=share * robot.com[1],
        com_height=robot.wheel_radius + share * (robot.com[2] - robot.axle_height),
        gain=robot.gain,
        armature=robot.armature,
        wheel_inertia=robot.wheel_inertia[1],
        link=robot.link,
        friction=robot.friction,
    )


def declare(name: str) -> PlantKind:
    """Return the declaration of a planar model, or of the robot on four tyres.

    Raises:
        ValueError: there is no such model.
    """
    if name == "four_wheel":
        return PlantKind(
            name,
            FourWheelParameters,
            tyred_defaults,
            _four_wheel_plant,
            _TYRED_FREE,
            colour="#56b4e9",
            torques=True,
        )
    law = planar_law(name)
    searched = tuple(
        n for n, d in describe_parameters(law.parameters).items() if d.search is not None
    )
    free: Free = {
        "scenario": (*searched, *_READ_OFF),
        "commands": (
            *searched,
            "wheel_radius",
            "effective_half_track",
            *_DRIVEN,
            "tracked_y",
            *SEEN,
        ),
        "wheels": (*_ROLLING, "tracked_y", *SEEN),
    }
    drive = tuple(n for n in describe_parameters(Drive) if n not in _MOTOR or not law.ideal)
    return PlantKind(
        name,
        law.parameters,
        _kinematic_defaults
        if name == "kinematic"
        else partial(_default_parameters, law.parameters),
        lambda section, *_: PlanarPlant(_model_of(section)),
        _KINEMATIC if law.ideal else free,
        colour=law.colour,
        vehicle=law.vehicle,
        drive=drive,
        together=_PlanarPopulation,
    )


def _four_wheel_plant(section: PlantProfile, *_: object) -> FourWheelPlant:
    """Return the robot on four tyres; it knows neither terrain nor physics settings."""
    return FourWheelPlant(section.parameters, section.drive)


class _PlanarPopulation:
    """Candidates of a model that one compiled loop drives on all threads."""

    def __init__(
        self,
        candidates: Sequence[PlantProfile | None],
        workers: int,
    ) -> None:
        """Keep the candidates; None stands for one that cannot be built."""
        self._workers = workers
        self._built = [None if c is None else (_model_of(c), c.localiser) for c in candidates]

    def motions(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates, see `Population.motions`."""
        out = np.full((len(which), sample_count(piece, sample_dt), 3), np.nan)
        rows = [row for row, i in enumerate(which) if self._built[i] is not None]
        if not rows:
            return out
        built = [pair for i in which if (pair := self._built[i]) is not None]
        models, localisers = zip(*built, strict=True)
        # most candidates share a localiser
        starts = {localiser: localiser.body_state(piece.start) for localiser in set(localisers)}
        begins = [starts[localiser] for localiser in localisers]
        poses = run_population(models, piece.commands, begins, sample_dt, workers=self._workers)
        for row, localiser, pose in zip(rows, localisers, poses, strict=True):
            out[row] = localiser.logged_poses(pose, sample_dt, piece.t)
        return out
