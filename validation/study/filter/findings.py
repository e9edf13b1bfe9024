"""The numbers of a study of dead reckoning: surfaces, filters and their drift.

Errors are those of the pose relative to the beginning of a stretch of `DRIFT_STRETCH`, because on a path that closes an
error of scale returns to nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from ssmr.control.loop import Feedback
from ssmr.estimation.settings import EkfSettings
from ssmr.geometry import relative, travelled, wrap_angle
from ssmr.parameters import require_in_range, require_within
from ssmr.robot.sensors import STANDS
from ssmr.types import FloatArray, Trajectory
from validation.bench.loops import ClosedLoopRobot
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile
from validation.plants.table import PLANTS
from validation.simulator.description import Robot
from validation.simulator.plant import MujocoPlant
from validation.study.options import require_seeds

DRIFT_STRETCH = 3.0
"""Length of a stretch over which relative errors are taken [m]: 12 s at 0.25 m/s."""
CURVE = 161
"""Number of samples of an error over the distance, from 0 to the end of the drive."""
REAL_BIAS = -0.0156
"""Bias of a real Husky's gyro on tile [rad/s]."""
_LEAST_TURN = 1e-3
"""A robot that turns by less has no yaw drift per radian [rad]."""


@dataclass(frozen=True)
class FilterVariant:
    """A filter and its sensors."""

    name: str
    """Name in tables."""
    gyro: bool = True
    """True if there is a gyro."""
    bias: float = 0.0
    """Bias of the gyro, which the filter does not know [rad/s]."""
    radius_known: bool = False
    """True if the odometry uses the tyres' rolling radius instead of the driver's."""
    commissioned: bool = False
    """True for a filter that knows the robot's constants from drives on the profile's own ground, and learns."""


def filter_variants(bias: float = REAL_BIAS) -> tuple[FilterVariant, ...]:
    """Return the filters that are compared; `bias` [rad/s] is that of the gyro of one of them."""
    return (
        FilterVariant("wheels", gyro=False),
        FilterVariant("wheels + gyro"),
        FilterVariant("biased gyro", bias=bias),
        FilterVariant("radius known", radius_known=True),
        FilterVariant("commissioned", commissioned=True),
        FilterVariant("commissioned, biased", bias=bias, commissioned=True),
    )


@dataclass(frozen=True, eq=False)
class FilterGround:
    """A robot on a ground."""

    name: str
    """Name in tables."""
    profile: Profile
    """Profile of the robot."""
    friction: float
    """Friction of tyre on ground [1], instead of the profile's."""

    def robot(self, timestep: float) -> ClosedLoopRobot:
        """Return the MuJoCo robot on this ground, with a physics step [s]."""
        section = self.profile.plants["mujoco"]
        parameters = replace(section.parameters, friction=self.friction, timestep=timestep)
        return ClosedLoopRobot("mujoco", MujocoPlant(parameters, section.drive))

    def filter_settings(self, variant: FilterVariant, known: EkfSettings | None = None) -> EkfSettings:
        """Return the assumptions of a filter there: the driver's half-track, and its wheel radius or the true one.

        A filter that is commissioned is `known`, with the driver's odometry if that is not given.
        """
        section = self.profile.plants["mujoco"]
        if variant.commissioned and known is not None:
            return known
        odometry = odometry_of(section.drive)
        return replace(odometry, radius=section.parameters.wheel_radius) if variant.radius_known else odometry


def grounds_of(profiles: Sequence[Profile], frictions: Sequence[float]) -> tuple[FilterGround, ...]:
    """Return every profile's ground, then the last profile's robot on grounds of other frictions.

    Raises:
        ValueError: two of them would have one name.
    """
    last = profiles[-1]
    made = [FilterGround(p.name, p, p.plants["mujoco"].parameters.friction) for p in profiles]
    made += [FilterGround(f"{last.name}, friction {f:g}", last, f) for f in frictions]
    if len({s.name for s in made}) != len(made):
        raise ValueError("a surface is named twice")
    return tuple(made)


@dataclass(frozen=True)
class FilterOptions:
    """Options of the study of dead reckoning."""

    references: tuple[str, ...] = ("sine", "circle")
    """References to drive: line, circle, sine, generic, or paths of waypoint files."""
    speed: float = 0.25
    """Speed of the references [m/s]."""
    profiles: tuple[str, ...] = ()
    """Robots on their grounds: names of shipped profiles or paths of TOML files; if none is named, thesis-lab and
    husky-tile, or the robot's own numbers if these are of another robot than `robot`."""
    frictions: tuple[float, ...] = (0.3, 0.6, 0.9)
    """Further frictions for the last profile's robot [1]."""
    bias: float = REAL_BIAS
    """Bias of the biased gyro [rad/s]."""
    stands: float = STANDS
    """Time for which the robot stands before a drive, while a filter that learns listens to its gyro [s]."""
    plants: tuple[str, ...] = ("improved",)
    """Plants on which it is measured how sure filters may be, on every profile; none for none."""
    feedbacks: tuple[str, ...] = get_args(Feedback)
    """Signals that the controller sees meanwhile: truth, noisy, ekf."""
    runs: int = 16
    """Number of robots for that, which differ as the filter says that they may."""
    seeds: int = 20
    """Number of draws of the sensors' noise."""
    seed: int = 0
    """Seed of the first draw."""
    timestep: float = 0.002
    """Physics step [s]."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profiles' if none is named."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: no references or seeds, a name that stands twice, a bias that is no number, or a step that
                the simulation cannot have.
        """
        for what, names in (("references", self.references), ("profiles", self.profiles)):
            if len(set(names)) < len(names) or not (names or what == "profiles"):
                raise ValueError(f"{what} {','.join(names)} must name at least one, and none twice")
        require_seeds(self)
        if unknown := sorted({*self.plants} - {*PLANTS}):
            raise ValueError(f"unknown plants {', '.join(unknown)}; there are: {', '.join(PLANTS)}")
        if unknown := sorted({*self.feedbacks} - {*get_args(Feedback)}):
            raise ValueError(f"unknown feedbacks {', '.join(unknown)}; there are: {', '.join(get_args(Feedback))}")
        if self.runs < 1:
            raise ValueError(f"runs {self.runs} must be at least 1")
        require_within(self, ("bias",), -100.0, 100.0)
        require_within(self, ("speed",), 1e-3, 100.0)
        require_in_range(self, "stands", 0.0, 1000.0)
        require_in_range(self, "timestep", 1e-5, 0.01)


@dataclass(frozen=True)
class Drift:
    """Errors of a filter after one drive."""

    position: float
    """Error of the relative position over stretches of `DRIFT_STRETCH`, over their length [1]."""
    yaw: float
    """Error of the relative yaw over the same stretches, over what the robot turned in them [1]; NaN if it did not turn."""
    end: float
    """Error of the position at the end, over the whole distance [1]."""
    end_yaw: float
    """Error of the yaw at the end, signed [rad]."""


def drift_of(believed: Trajectory, truth: Trajectory) -> Drift:
    """Return the errors of a filter.

    Args:
        believed: the filter's motion at the instants of `truth`.
        truth: the robot's motion, at least `DRIFT_STRETCH` long.

    Raises:
        ValueError: the drive is too short.
    """
    along = travelled(truth.xy)
    count = int(along[-1] / DRIFT_STRETCH + 1e-9)
    if count < 1:
        raise ValueError(f"a drive of {along[-1]:.2f} m is shorter than the {DRIFT_STRETCH:g} m over which drift is taken")
    ends = np.minimum(np.searchsorted(along, DRIFT_STRETCH * np.arange(count + 1) - 1e-9), len(along) - 1)
    first, last = ends[:-1], ends[1:]
    error = relative(truth.pose[first], truth.pose[last]) - relative(believed.pose[first], believed.pose[last])
    turned = np.cumulative_sum(np.abs(np.diff(truth.pose[:, 2])), include_initial=True)
    turn = float(turned[ends[-1]] - turned[ends[0]])
    off = believed.pose[-1] - truth.pose[-1]
    return Drift(
        float(np.hypot(error[:, 0], error[:, 1]).sum() / (along[ends[-1]] - along[ends[0]])),
        float(np.abs(wrap_angle(error[:, 2])).sum() / turn) if turn > _LEAST_TURN else math.nan,
        float(np.hypot(off[0], off[1]) / along[-1]),
        float(off[2]),
    )


@dataclass(frozen=True, eq=False)
class VariantDrift:
    """Errors of one filter on one drive, with every draw of the noise."""

    drifts: tuple[Drift, ...]
    """Errors by seed."""
    errors: FloatArray
    """(seeds, CURVE) error of the position [m] over the distance, evenly from 0 to the end."""

    def mean(self, name: str) -> float:
        """Return the mean over seeds of a field of `Drift`."""
        return float(np.mean([getattr(d, name) for d in self.drifts]))

    def std(self, name: str) -> float:
        """Return the standard deviation over seeds of a field of `Drift`; 0 for one seed."""
        values = [getattr(d, name) for d in self.drifts]
        return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class GroundDrive:
    """One reference driven on one ground."""

    surface: str
    """Name of the ground."""
    reference: str
    """Name of the reference."""
    distance: float
    """Distance driven [m]."""
    turned: float
    """Angle turned, to either side [rad]."""
    slide: float
    """Root mean square of the lateral speed, which the filter takes to be 0, over that of the speed [1]."""
    filters: Mapping[str, VariantDrift]
    """Errors by name of the filter."""
