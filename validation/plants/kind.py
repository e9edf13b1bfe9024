"""Declaration of a plant: everything that fits and comparisons need to know of it."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np

from ssmr.errors import ParameterError, SsmrError
from ssmr.geometry import compose_poses
from ssmr.metrics.bands import Band
from ssmr.parameters import describe_parameters
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import TORQUES, Commands, FloatArray, Plant, State, Trajectory
from validation.output import Document
from validation.simulator.description import Robot
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.terrain import FLAT

Occasion = Literal["scenario", "commands", "wheels"]
"""Occasion of a fit: to a plant's motion in a scenario, or to a log whose commands or wheel rates
drive the plant."""
Free = Mapping[Occasion, tuple[str, ...]]
"""Names of the numbers that a fit moves unless the user says otherwise, by its occasion."""

SEEN = ("tracked_x", "tracked_yaw", "position_late", "yaw_late")
"""Numbers of the localiser that a fit to a log has to find, whatever drives the plant."""

GROUND_TORQUES = "ground_torque_N_m"
"""Channel of a motion whose wheel rates are given: the (M, 2) torques on the ground [N m]."""
CAUSES = (
    "com_x",
    "friction",
    "command_half_track",
    "wheel_radius",
    "acceleration_v",
    "dc_stiffness",
)
"""Causes of a body's motion in a scenario, which a fit moves; the tracked point is no cause."""

PARTS = ("parameters", "vehicle", "drive", "localiser")
"""The parts of a plant's profile that hold numbers."""


@dataclass(frozen=True)
class PlantProfile:
    """Everything that defines one plant of a profile."""

    parameters: Any
    """The plant's own parameters, of the type that its `PlantKind` declares."""
    vehicle: Vehicle
    """Mass and geometry; a plant with a body of its own has them in `parameters`."""
    drive: Drive
    """Saturation, delays and conversions between command and wheels."""
    robot: Robot
    """The robot that these numbers are of."""
    localiser: Localiser = Localiser()
    """Frame on the body whose motion is compared, and how late a log tells it."""
    bands: Mapping[str, Band] = field(default_factory=dict, hash=False)
    """Uncertainty of predictions, by the input that drives the plant: `commands` or `wheels`."""
    spread: Mapping[str, float] = field(default_factory=dict, hash=False)
    """Standard deviation of numbers from one day to another, by name, in each number's unit."""

    def numbers(self) -> dict[str, Document]:
        """Return the numbers of each part by name, without the robot, which has its own file."""
        numbers = {}
        for part in PARTS:
            owner = getattr(self, part)
            names = [f.name for f in fields(owner) if f.name != "robot"]
            numbers[part] = {name: getattr(owner, name) for name in names}
        return numbers


class Stretch(Protocol):
    """A stretch of motion that a population is driven over."""

    @property
    def commands(self) -> Commands:
        """Commands, from the first stamp on."""
        ...

    @property
    def start(self) -> State:
        """State of the tracked frame at the first stamp."""
        ...

    @property
    def t(self) -> FloatArray | None:
        """(M,) stamps at which poses are asked for [s]; None for the samples of the simulation."""
        ...


class Population(Protocol):
    """S candidates of one plant, ready to be driven."""

    def motions(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates over one stretch.

        Args:
            which: indices of the candidates.
            piece: commands, start and stamps.
            sample_dt: period at which plants are sampled [s].

        Returns:
            (len(which), M, 3) poses of each candidate's tracked frame. A plant whose torques are a
            body's has two columns more, the torques of its left and right motors [N m]. All is
            NaN for a candidate that cannot be built or diverges.
        """
        ...


def sample_count(piece: Stretch, sample_dt: float) -> int:
    """Return the number of poses of a motion over one stretch, see `Population.motions`."""
    if piece.t is None:
        return 1 + round(piece.commands.duration / sample_dt)
    return len(piece.t)


def side_torques(motion: Trajectory) -> FloatArray | None:
    """Return the (M, 2) torques of both sides [N m], on the ground where wheel rates are given."""
    return motion.channels.get(TORQUES, motion.channels.get(GROUND_TORQUES))


_KEPT = 12
"""Greatest number of bodies whose motions are kept: those of the central derivatives of five of
their numbers, and one."""


@lru_cache(maxsize=_KEPT)
def _motions_of(*body: object) -> dict[tuple[Commands, State, float], Trajectory]:
    """Return the motions that are known of a body from the origin, for more to be added."""
    return {}


class OneByOne:
    """Candidates that are driven one after another; the caller spreads them over threads.

    How a body is seen moves nothing: candidates that differ in their localisers alone have one
    motion, unless these tell other velocities at its start.
    """

    def __init__(
        self,
        build: Callable[..., Plant],
        candidates: Sequence[PlantProfile | None],
        settings: PhysicsSettings,
    ) -> None:
        """Keep the candidates; None stands for one that cannot be built."""
        self._build = build
        self._candidates = candidates
        self._settings = settings

    def motions(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates, see `Population.motions`."""
        out = np.full((len(which), sample_count(piece, sample_dt), 5), np.nan)
        for row, i in enumerate(which):
            candidate = self._candidates[i]
            # a candidate that cannot be built or diverges keeps its NaN, which no cost accepts
            with contextlib.suppress(ParameterError, SsmrError):
                if candidate is not None:
                    seen = self._seen_motion(candidate, piece, sample_dt)
                    out[row, :, :3] = seen.pose
                    out[row, :, 3:] = seen.channels.get(TORQUES, math.nan)
        return out

    def _seen_motion(self, candidate: PlantProfile, piece: Stretch, sample_dt: float) -> Trajectory:
        """Return the poses and torques of a candidate over one stretch, as its localiser sees them.

        Raises:
            ParameterError: it cannot be built.
            SsmrError: it diverged.
        """
        localiser = candidate.localiser
        body = replace(candidate, localiser=Localiser()), FLAT, self._settings
        known = _motions_of(self._build, *body)
        start = localiser.body_state(piece.start)
        drive = piece.commands, replace(start, x=0.0, y=0.0, yaw=0.0), sample_dt
        if drive not in known:
            motion = self._build(*body).run(*drive)
            torques = side_torques(motion)
            channels = {} if torques is None else {TORQUES: torques}
            known[drive] = replace(motion, channels=channels)
        pose = compose_poses((start.x, start.y, start.yaw), known[drive].pose)
        return localiser.seen(replace(known[drive], pose=pose), piece.t)


@dataclass(frozen=True, eq=False)
class PlantKind:
    """The declaration of a plant."""

    name: str
    """Name in commands, tables and files."""
    parameters: type
    """Frozen dataclass of the plant's own parameters, declared with `ssmr.parameters.parameter`."""
    defaults: Callable[[Robot], Any]
    """Function that returns the parameters of a robot that nothing was fitted to."""
    build: Callable[..., Plant]
    """Function that builds the plant from its numbers, its ground and its physics settings."""
    free: Free
    """Names of the numbers that a fit moves unless the user says otherwise."""
    colour: str = "#808080"
    """Colour in pictures and recordings, as #rrggbb."""
    vehicle: tuple[str, ...] = ()
    """Fields of the vehicle that a fit may move."""
    drive: tuple[str, ...] = tuple(describe_parameters(Drive))
    """Fields of the drive that a fit may move."""
    together: Callable[[Sequence[PlantProfile | None], int], Population] | None = None
    """Function that prepares candidates for one compiled loop, which drives them on a number of
    threads; None where each is driven on a thread of its own."""
    held: Callable[[Any], Collection[str]] = lambda _: ()
    """Function that returns which of these a fit to a log leaves alone, for the plant's numbers."""
    torques: bool = False
    """Whether the channel `TORQUES` has the torques of a body on wheels, so that they can be
    compared with others; those of planar models are numbers of a fit. Its motors have an integral
    part unless the robot's file says otherwise."""

    def population(
        self,
        candidates: Sequence[PlantProfile | None],
        workers: int,
        settings: PhysicsSettings = SHIPPED,
    ) -> Population:
        """Prepare candidates, None for one that cannot be built, for a number of threads.

        The `settings` say how the physics of simulated bodies is computed.
        """
        if self.together is None:
            return OneByOne(self.build, candidates, settings)
        return self.together(candidates, workers)
