"""Declaration of a plant: everything that fits and comparisons need to know of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol

import numpy as np

from ssmr.errors import ParameterError, SsmrError
from ssmr.metrics.bands import Band
from ssmr.parameters import describe_parameters
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import TORQUES, Commands, FloatArray, Plant, State, Trajectory
from validation.output import Document
from validation.simulator.description import Robot

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


class OneByOne:
    """Candidates that are driven one after another; the caller spreads them over threads."""

    def __init__(
        self,
        build: Callable[[PlantProfile], Plant],
        candidates: Sequence[PlantProfile | None],
    ) -> None:
        """Build the candidates; None stands for one that cannot be built."""
        self._built = dict[int, tuple[Plant, Localiser]]()
        for i, candidate in enumerate(candidates):
            if candidate is not None:
                with contextlib.suppress(ParameterError):
                    self._built[i] = build(candidate), candidate.localiser

    def motions(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates, see `Population.motions`."""
        out = np.full((len(which), sample_count(piece, sample_dt), 5), np.nan)
        for row, i in enumerate(which):
            if i not in self._built:
                continue
            plant, localiser = self._built[i]
            # a candidate that diverges keeps its NaN, which no cost accepts
            with contextlib.suppress(SsmrError):
                start = localiser.body_state(piece.start)
                motion = localiser.seen(plant.run(piece.commands, start, sample_dt), piece.t)
                out[row, :, :3] = motion.pose
                torques = side_torques(motion)
                if torques is not None:
                    out[row, :, 3:] = torques
        return out


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
    torques: bool = False
    """Whether the channel `TORQUES` has the torques of a body on wheels, so that they can be
    compared with others; those of planar models are numbers of a fit. Its motors have an integral
    part unless the robot's file says otherwise."""

    def population(self, candidates: Sequence[PlantProfile | None], workers: int) -> Population:
        """Prepare candidates, None for one that cannot be built, for a number of threads."""
        if self.together is None:
            return OneByOne(self.build, candidates)
        return self.together(candidates, workers)
