"""Who takes part in a study of transfer: controllers with their gains, and references at speeds that the robot can drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssmr.control.laws import LAWS, PLAIN_CONTROLLERS, PREDICTOR
from ssmr.control.waypoints import Waypoints
from ssmr.parameters import require_within
from validation.bench.gains import DEFAULT, GainSet, load_gains, names, profile_sets
from validation.bench.loops import AnyController, ClosedLoopRobot, chosen_controller, within_reach
from validation.bench.user_law import is_user_law
from validation.bench.waypoint_files import REFERENCES, open_reference, split_speed
from validation.files.reading import FileError
from validation.plants.profile import PLANTS, Profile
from validation.simulator.description import Robot
from validation.study.result import require_seeds

TRANSFER_CONTROLLERS = (*PLAIN_CONTROLLERS, "lqr+predictor", "lqr-scheduled+predictor", "mpc")
"""Controllers of the usual study."""
TRANSFER_PROFILES = ("thesis-lab", "husky-tile")
"""Profiles of the usual study; the quick one has the first."""
TRANSFER_REFERENCES = (
    "eight", "u-turn", "stop-and-go",
    "slalom", "square", "spiral", "sine", "generic", "circle", "line",
)  # fmt: skip
"""References of the usual study; the quick one has the first three."""
TRANSFER_SPEEDS = (0.25, 0.5)
"""Speeds of the usual study [m/s], the thesis' two; the quick one has the last."""
PRACTICABLE = 0.9
"""Share of the robot's greatest speed and yaw rate that a reference may ask for; what is left is for corrections."""


@dataclass(frozen=True)
class TransferOptions:
    """Options of the study of transfer."""

    profiles: tuple[str | Profile, ...] = ()
    """Robots: names of shipped profiles, or paths of TOML files."""
    plants: tuple[str, ...] = PLANTS
    """Plants to drive. The judge is driven too."""
    judge: str = "mujoco"
    """Plant that stands for the robot: the others are to choose the right controller for it."""
    controllers: tuple[str, ...] = TRANSFER_CONTROLLERS
    """Controllers with all their shipped gains; pid:tuned is one with one set, pid:FILE.toml one with gains of your own."""
    own: tuple[str, ...] = ()
    """Controllers of your own beside them: classes in Python files."""
    references: tuple[str, ...] = ()
    """References by name or path; circle@0.4 has its own speed."""
    waypoints: tuple[str, ...] = ()
    """Waypoint files of your own (.csv) beside the references. Their own times count, if they have any."""
    speeds: tuple[float, ...] = ()
    """Speeds of references that bring none [m/s]. What the judge cannot drive is driven more slowly."""
    seeds: int = 1
    """Number of draws of noise and disturbance."""
    seed: int = 11
    """First seed of noise and disturbance; no shipped set was tuned with seeds from 11 on."""
    quick: bool = False
    """Take one profile, three references and one speed where none are named."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Check numbers and that there is something to compare.

        Raises:
            ValueError: no seeds, a speed out of its range, or no plant besides the judge.
        """
        require_seeds(self)
        require_within(self, ("speeds",), 1e-3, 100.0)
        if not set(self.plants) - {self.judge}:
            raise ValueError(f"plants names none besides the judge {self.judge}; name one that is to choose for it")

    @property
    def seeds_text(self) -> str:
        """The seeds in words, such as `seeds 11 to 13`."""
        return f"seed {self.seed}" if self.seeds == 1 else f"seeds {self.seed} to {self.seed + self.seeds - 1}"

    @property
    def plant_names(self) -> tuple[str, ...]:
        """Names of the plants, the judge first."""
        return (self.judge, *(name for name in self.plants if name != self.judge))


@dataclass(frozen=True, eq=False)
class Contender:
    """A controller with its gains."""

    law: AnyController
    """The controller."""
    gains: GainSet | None
    """Its gains; a user's class has none."""
    foresees: bool | None
    """True if it acts on the state one dead time ahead; None for a user's class, of which that is not known."""


def contenders_of(o: TransferOptions, profile: Profile) -> dict[str, Contender]:
    """Return controllers with their gains on a profile, by the name that they have in tables.

    Raises:
        ValueError: an unknown controller, gains or file, one name for two, or fewer than two contenders.
    """
    found: dict[str, Contender] = {}
    for named in (*o.controllers, *o.own):
        for name, contender in _named(named, profile).items():
            if name in found:
                raise ValueError(f"two controllers are called '{name}'; leave out '{named}', or rename it")
            found[name] = contender
    if len(found) < 2:
        raise ValueError(f"there is no choice among {', '.join(found) or 'no controllers'}; name two or more")
    return found


def _named(named: str, profile: Profile) -> dict[str, Contender]:
    """Return the contenders that a name stands for."""
    if is_user_law(named):
        law, _ = chosen_controller(named, profile)
        return {law.name: Contender(law, None, None)}
    controller, colon, wanted = named.partition(":")
    sets = _shipped(controller, profile)
    if colon:
        sets = {Path(wanted).stem: sets.get(wanted) or load_gains(controller, wanted, profile.name)}
    foresees = controller.endswith(PREDICTOR) or LAWS[controller].make is not None
    return {
        controller if kind == DEFAULT else f"{controller} {kind}": Contender(
            chosen_controller(controller, profile, gains)[0], gains, foresees
        )
        for kind, gains in sets.items()
    }


def _shipped(controller: str, profile: Profile) -> dict[str, GainSet]:
    """Return the gains that are shipped for a controller; where a profile has tuned gains of its own, those are `tuned`."""
    load_gains(controller, DEFAULT)  # says if there is no such controller
    kinds = [name.removeprefix(f"{controller}-") for name in names(controller)]
    found = {kind: load_gains(controller, kind) for kind in kinds}
    if profile.name in profile_sets(controller):
        found["tuned"] = load_gains(controller, profile.name)
    return found or {DEFAULT: load_gains(controller, DEFAULT)}


def missions_of(o: TransferOptions, robot: ClosedLoopRobot) -> list[tuple[str, Waypoints]]:
    """Return the references by name, each at every speed, or as fast as the robot can drive it.

    Raises:
        ValueError: an unknown reference, a file that cannot be read, one name for two references, or none.
    """
    usual = TRANSFER_REFERENCES[:3] if o.quick else TRANSFER_REFERENCES
    speeds = o.speeds or (TRANSFER_SPEEDS[-1:] if o.quick else TRANSFER_SPEEDS)
    found: dict[tuple[str, float], Waypoints] = {}
    homes: dict[str, str] = {}
    for named in (*(o.references or usual), *o.waypoints):
        for name, waypoints in _opened(named, speeds):
            home = homes.setdefault(name, split_speed(named)[0])
            if home != split_speed(named)[0]:
                raise ValueError(f"two references are called '{name}': {home} and {named}; rename one of the files")
            slowed = within_reach(waypoints, robot, PRACTICABLE)
            found.setdefault((name, round(slowed.speed, 3)), slowed)
    return [(name, waypoints) for (name, _), waypoints in found.items()]


def _opened(named: str, speeds: Sequence[float]) -> list[tuple[str, Waypoints]]:
    """Return a reference at each speed, or once where it brings its own."""
    name, own = split_speed(named)
    if own is not None:
        return [open_reference(named)]
    if name not in REFERENCES:
        try:
            return [open_reference(named)]
        except FileError:  # it has no times, or is said to be wrong by the next line too
            pass
    return [open_reference(named, speed) for speed in speeds]


def gains_by_name(contenders: Mapping[str, Contender]) -> dict[str, dict[str, object] | None]:
    """Return the name and the numbers of everybody's gains, as a file holds them."""
    return {
        name: None if c.gains is None else {"controller": c.gains.controller, "name": c.gains.name, **c.gains.values}
        for name, c in contenders.items()
    }
