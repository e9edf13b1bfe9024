"""What a fit begins with and what it holds.

The fit of a body on wheels to logs begins at what the kinematic model finds in them.

That model has the radii, the lateness and the mount of the localiser, and the driver, as plain
numbers, and finds them in less than a second. How a body turns, where its weight lies, is what is
left to find; its friction is held where the logs do not tell it.

A friction that resists turns takes a constant off the yaw rate. Where all turns have one amplitude
that is a gain, and one number with the half-track: a planar model holds it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ssmr.errors import SsmrError
from ssmr.parameters import require_one_of
from ssmr.robot.ground import SkidTurn, turn_on_the_spot
from ssmr.scenarios import TRAJECTORIES
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.experiment.sources import RECORDING, Source
from validation.identify.problem import FitProblem, turning_doubt
from validation.identify.search import SETTINGS, Searching, search_for
from validation.identify.uncertainty import estimate_uncertainty
from validation.output import ignore_progress
from validation.plants.kind import PlantProfile
from validation.plants.searchable import find_number, make_space, split_by_log, with_values
from validation.plants.table import SIMULATED, plant_kind
from validation.simulator.description import Robot

FIRST_FITTED = "kinematic"
"""Plant whose fit others begin with."""
_RESISTS_TURNS = "mu_"
"""Beginning of the names of coefficients of a friction that resists turns, however slow."""
_REACH = 0.4
"""Greatest distance of the weight from the middle between the axles over the wheelbase [1]."""


def _weight_for_turn(robot: Robot, width: float) -> tuple[float, float]:
    """Return where a robot's weight lies whose sides' centres of rotation are so far apart [m].

    First is its distance from the middle between the axles [m], in a turn on the spot in closed
    form: the closer to an axle, the easier a robot turns. Second is how far the body's centre of
    rotation is then off the middle, to the same side [m]. A robot that turns less than one with its
    weight in the middle has it there.
    """

    def turn(x: float) -> SkidTurn:
        return turn_on_the_spot(robot.wheelbase, robot.track, x)

    ends = (0.0, _REACH * robot.wheelbase)
    most, least = (2.0 / turn(x).yaw_rate for x in ends)
    within = min(max(width, least), most)
    x = brentq(lambda x: 2.0 / turn(x).yaw_rate - within, *ends)
    return x, -turn(x).across / turn(x).yaw_rate


def first_points(
    guess: str | Mapping[str, float] | None, space: ParameterSpace, before: FloatArray
) -> FloatArray:
    """Return the (1, n) candidate to begin with in the unit cube, within the bounds.

    It has the (n,) values of `before`, and those of a `guess` by name in their place.
    """
    named = guess if isinstance(guess, Mapping) else {}
    numbers = [name.partition("@")[0] for name in space.names]
    for name in named:
        if name not in (*space.names, *numbers):
            raise ValueError(f"guess names {name}, which is not free")
    within = np.clip(before, space.lower, space.upper)
    values = [
        named.get(name, named.get(number, value))
        for name, number, value in zip(space.names, numbers, within, strict=True)
    ]
    return space.points(np.array([values]))


def begin_at(
    body: FitProblem, first: PlantProfile, names: Sequence[str], o: Searching, notes: list[str]
) -> FloatArray:
    """Return the (1, n) candidate that has what the kinematic plant `first` finds in the logs.

    The plant's numbers `names` are fitted to the logs of the body's problem; a sentence of `notes`
    says where the robot turns less than a body that slides can. Weight ahead of the
    middle makes the same turn as weight behind it: the candidate has that which errs less.

    Raises:
        KeyboardInterrupt: that fit was interrupted.
        SsmrError: no candidate could be driven.
    """
    robot = first.robot
    space = make_space(FIRST_FITTED, names, {}, robot)
    problem = FitProblem(FIRST_FITTED, first, space, body.sources, body.cost, body.held)
    alone = replace(o, out=None, resume=False, progress=ignore_progress)
    search = search_for(problem, SETTINGS["hybrid"][0], alone, problem.begun[None], "hybrid")
    if search.interrupted:
        raise KeyboardInterrupt
    numbers = dict(zip(names, space.values(search.best).tolist(), strict=True))
    first = with_values(FIRST_FITTED, first, names, numbers.values())
    p = first.parameters
    # wheels of its own roll as the shares of those say
    numbers["wheel_radius"] = 0.5 * first.vehicle.wheel_radius * (p.alpha_l + p.alpha_r)
    numbers["radius_difference"] = first.vehicle.wheel_radius * (p.alpha_l - p.alpha_r)
    # weight off the middle makes a turn easier, and nothing that slides makes it so much harder
    share = 0.5 * (p.y_l - p.y_r) * turn_on_the_spot(robot.wheelbase, robot.track, 0.0).yaw_rate
    if share > 1.0 + turning_doubt(robot):
        notes.append(
            f"Its wheels turn {share:.2f} times as much for a turn as those of a body that slides: "
            "wheels hop, or something else resists, so friction is not to be believed."
        )
    x, icr = 0.0, 0.0
    if "com_x" in body.space.names:
        x, icr = _weight_for_turn(robot, p.y_l - p.y_r)
    if body.model in SIMULATED:
        x *= robot.mass / robot.base_mass  # its number is that of the base without wheels
    before = body.space.values(body.begun)
    points = []
    for sign in (-1.0, 1.0):
        tracked = first.localiser.tracked_x - p.x_icr + sign * icr
        start = {**numbers, "com_x": sign * x, "tracked_x": tracked}
        values = [
            start.get(name, value) for name, value in zip(body.space.names, before, strict=True)
        ]
        points.append(first_points(None, body.space, np.array(values)))
    costs = (body.coarser() or body).costs(np.concatenate(points), None, o.raters)
    return points[np.argmin(costs)]


def searched_names(
    named: Sequence[str], names: Sequence[str], held: Collection[str], sources: Sequence[Source]
) -> list[str]:
    """Return the names that are searched, of those that are not held: one of each of several logs.

    Raises:
        ValueError: one that is `named` anywhere is of a log or a ground that is none.
    """
    logs = [source.tags[0] for source in sources if source.reference == RECORDING]
    grounds = dict.fromkeys(chain(*(source.tags[1:] for source in sources)))
    for name in named:
        _, at, tag = name.partition("@")
        if at:
            require_one_of(tag, {*logs, *grounds}, f"{name} names no log and no ground")
    free = [name for name in names if name not in held]
    split = split_by_log(free, logs if len(logs) > 1 else (), grounds if len(grounds) > 1 else ())
    return [name for name in split if name not in held]


def untold_by_amplitude(model: str, scenarios: Sequence[str]) -> list[str]:
    """Return a planar model's frictions that turns of one amplitude in scenarios do not tell."""
    amplitudes = {TRAJECTORIES[name.partition("@")[0]].amplitude for name in scenarios}
    kind = plant_kind(model)
    if kind.torques or len(amplitudes) > 1:
        return []
    return [name for name in kind.free["scenario"] if name.startswith(_RESISTS_TURNS)]


def amplitude_sentences(problem: FitProblem, held: Sequence[str]) -> list[str]:
    """Return what a fit holds because of one amplitude, or what its plant lacks for several."""
    out = []
    for name in held:
        value = find_number(problem.model, name, problem.base.robot).read(problem.base)
        out.append(
            f"{name} is held at {value:.3g}: turns of one amplitude cannot tell it from the "
            "half-track. Several can, such as --to traj4@mujoco,traj2@mujoco; --free frees it."
        )
    resists = any(name.startswith(_RESISTS_TURNS) for name in problem.space.names)
    if len(problem.sources) > 1 and not (resists or plant_kind(problem.model).torques):
        out.append(
            f"{problem.model} has no free friction that takes a constant off the yaw rate: turns "
            "of several amplitudes are more than it can hold, and errors are centimetres."
        )
    return out


def friction_left_untold(problem: FitProblem, start: FloatArray, o: Searching) -> NDArray[np.bool_]:
    """Return the (n,) frictions of a body that the logs hardly tell, by derivatives at a start.

    The standard error to expect is then about as large as what is known without the logs. Without
    torques a simulated body slips by its contact's softness, a guess, as much as by its friction.
    """
    asked = np.array(
        [
            name.partition("@")[0] == "friction" and not {name, "friction"} & {*o.bounds}
            for name in problem.space.names
        ]
    )
    if problem.model in SIMULATED and not problem.torques:
        return asked
    with contextlib.suppress(SsmrError, np.linalg.LinAlgError):
        sure = estimate_uncertainty(problem.coarser() or problem, start[0], o.raters, foreseen=True)
        return asked & sure.untold
    return asked & False
