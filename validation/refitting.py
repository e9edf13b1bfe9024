"""Fits that go on from other fits: within wider bounds, with less, or by another plant."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from validation import cli
from validation.fit import Fit, Fitted, run_fit
from validation.identify.beginning import FIRST_FITTED
from validation.identify.targets import Input
from validation.output import Document
from validation.plants.searchable import OF_A_LOG, find_number, make_space
from validation.plants.table import plant_kind

ESSENTIAL = (
    *("alpha_l", "alpha_r", "y_l", "y_r", "wheel_radius", "command_radius"),
    *("command_half_track", "tracked_x", "tracked_y", "tracked_yaw"),
)
"""Sizes of a robot and the place of its localiser: at a bound they stand for something else."""
_WIDER = {*ESSENTIAL, "drift", "position_late", "yaw_late"} - {"tracked_yaw"}
"""Numbers whose bounds are widened where they are hit."""
_WIDENED = 0.5
"""Share of the bounds' width by which a bound that is hit is moved [1]."""
_WORTH = 0.98
"""Cost over the cost before from which a bound that was moved is not moved again [1]."""
_DRIVER = (
    *("command_radius", "command_half_track", "delay"),
    *("acceleration_v", "acceleration_w", "wheel_lag"),
)


def settings_of(
    known: Mapping[tuple[str, str], Sequence[Fitted]],
    plan: tuple[str, Input],
    k: int,
    done: Sequence[Fitted],
) -> Document:
    """Return the settings of the fit of a plant by an input to the k-th fold.

    `known` has the fits of all folds by plant and input, and `done` those of this plan.
    """
    plant, kind = plan
    settings: Document = {}
    if (plant, "wheels") in known:
        body = known[plant, "wheels"][k]
        track = body.base.robot.track
        settings = {
            "free": _DRIVER,
            "fix": _of_logs(body) if known[plant, "wheels"][-1].better else {},
            "bounds": {"command_half_track": (0.2 * track, 1.5 * track)},
        }
    if not plant_kind(plant).torques:
        return settings
    # its run is dear, and fits before know where to begin
    settings["search"] = "lsq"
    bounds = settings.get("bounds", {})
    if done:
        # what it held, because its data did not tell it, is held again
        held = {**settings.get("fix", {}), **_of_logs(done[-1])}
        settings |= settings_to_go_on(done[-1], plant, bounds) | {"fix": held}
    elif bounds:
        settings |= settings_to_go_on(known[FIRST_FITTED, kind][k], plant, bounds)
    return settings


def settings_to_go_on(
    f: Fitted, plant: str, bounds: Mapping[str, tuple[float, float]], without: str = ""
) -> Document:
    """Return settings of a fit that begins with what another has found, as far as `bounds` allow.

    It frees the same numbers but one that it does `without`; those of single logs have their mean.
    """
    numbers = (p.name.partition("@")[0] for p in f.parameters)
    names = [name for name in dict.fromkeys(numbers) if name != without]
    kept = {name: ends for name, ends in bounds.items() if name.partition("@")[0] in names}
    space = make_space(plant, names, kept, f.base.robot)
    found = [find_number(f.model, name, f.base.robot).read(f.plant) for name in names]
    guess = zip(names, np.clip(found, space.lower, space.upper).tolist(), strict=True)
    return {"free": tuple(names), "guess": dict(guess), "bounds": kept}


def fit_widely(options: Fit) -> Fitted:
    """Return a fit of what its data tell, within bounds that are moved where one is hit.

    They are moved again while that makes the fit better.

    Numbers of the driver that the data hardly determine are held, the least known first: of a sum
    that alone is known the other number then has it.
    """
    # the report names the log's faults once
    done = run_fit(options, lambda warning: None)
    remarks = []
    while options.input == "commands" and (name := _least_told(done)):
        bounds = cli.read_value(options.bounds)
        options = replace(options, **settings_to_go_on(done, done.model, bounds, name))
        done = run_fit(options, lambda warning: None)
        number = find_number(done.model, name, done.base.robot)
        value = number.text(number.read(done.plant))
        remarks.append(f"{name} is held at {value}: the commands hardly tell it.")
    moved = dict[str, tuple[float, float]]()
    cost = math.inf
    while (wider := _widen_bounds(done)) and done.course.cost < _WORTH * cost:
        cost = done.course.cost
        moved |= wider
        options = replace(options, bounds={**cli.read_value(options.bounds), **moved})
        done = run_fit(options, lambda warning: None)
    if moved:
        remarks.append(f"{', '.join(moved)} hit a bound, which was moved, and the fit repeated")
    return replace(done, remarks=[*done.remarks, *remarks])


def _least_told(f: Fitted) -> str | None:
    """Return the number of the driver that its data tell least, of those that they hardly tell."""
    if f.sure is None or len(f.parameters) < 2:
        return None
    shares = {}
    for p, share in zip(f.parameters, f.sure.share.tolist(), strict=True):
        # a limit that is never reached may as well be higher
        is_off = p.at_bound and p.name.startswith("acceleration")
        if (p.untold or is_off) and p.name in _DRIVER:
            shares[p.name] = share
    return max(shares, key=shares.__getitem__, default=None)


def _widen_bounds(f: Fitted) -> dict[str, tuple[float, float]]:
    """Return wider bounds of sizes and delays that ended at one, as far as physics allows."""
    bounds = {}
    for p, declared in zip(f.parameters, f.problem.space.parameters, strict=True):
        more = _WIDENED * (p.upper - p.lower)
        if not p.at_bound or p.name.partition("@")[0] not in _WIDER:
            continue
        low = max(p.lower - more, declared.least)
        high = min(p.upper + more, declared.greatest)
        # a size keeps its sign
        if p.lower >= 0.0:
            low = max(low, 0.5 * p.lower)
        if p.upper <= 0.0:
            high = min(high, 0.5 * p.upper)
        bounds[p.name] = low, high
    return bounds


def _of_logs(f: Fitted) -> dict[str, float]:
    """Return the numbers of single logs that a fit has found."""
    numbers = {}
    for p in f.parameters:
        number, at, _ = p.name.partition("@")
        if at and number in OF_A_LOG:
            numbers[p.name] = p.value
    return numbers
