"""Fits that go on from other fits: within wider bounds, with less, or by another plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from validation import cli
from validation.fit import Fit, Fitted, run_fit
from validation.identify.beginning import FIRST_FITTED
from validation.identify.targets import Input
from validation.plants.searchable import OF_A_LOG, find_number, make_space
from validation.plants.table import plant_kind

ESSENTIAL = (
    *("alpha_l", "alpha_r", "y_l", "y_r", "wheel_radius", "command_radius"),
    *("command_half_track", "tracked_x", "tracked_y", "tracked_yaw"),
)
"""Sizes of a robot and the place of its localiser: at a bound they stand for something else."""
_WIDER = {*ESSENTIAL, "drift", "position_late", "yaw_late"} - {"tracked_yaw"}
"""Numbers whose bounds are widened once where they are hit."""
_WIDENED = 0.5
"""Share of the bounds' width by which a bound that is hit is moved once [1]."""
_DRIVER = (
    *("command_radius", "command_half_track", "delay"),
    *("acceleration_v", "acceleration_w", "wheel_lag"),
)


def settings_of(
    known: Mapping[tuple[str, str], Sequence[Fitted]],
    plan: tuple[str, Input],
    k: int,
    done: Sequence[Fitted],
) -> dict[str, Any]:
    """Return the settings of the fit of a plant by an input to the k-th fold.

    `known` has the fits of all folds by plant and input, and `done` those of this plan.
    """
    plant, kind = plan
    settings: dict[str, Any] = {}
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
    if done:
        return settings | _options_to_go_on(
            done[-1], settings.get("free", plant_kind(plant).free[kind])
        )
    if "free" in settings:
        driver = known[FIRST_FITTED, kind][k]
        settings["guess"] = within_bounds(driver, plant, settings["bounds"])
    return settings


def _options_to_go_on(f: Fitted, names: Sequence[str]) -> dict[str, Any]:
    """Return where a fit of some numbers to other data begins that goes on from another one.

    What that one held, because its data did not tell it, is held again.
    """
    found = {p.name.partition("@")[0] for p in f.parameters}
    settings: dict[str, dict[str, float]] = {"guess": {}, "fix": {}}
    for name in names:
        number = find_number(f.model, name, f.base.robot)
        settings["guess" if name in found else "fix"][name] = number.read(f.plant)
    settings["fix"] |= _of_logs(f)
    return settings


def fit_widely(options: Fit) -> Fitted:
    """Return a fit of what its data tell, within bounds that are moved once where one is hit.

    Numbers of the driver that the data hardly determine are held, the least known first: of a sum
    that alone is known the other number then has it.
    """
    # the report names the log's faults once
    done = run_fit(options, lambda warning: None)
    remarks = []
    while options.input == "commands" and (name := _least_told(done)):
        names = dict.fromkeys(p.name.partition("@")[0] for p in done.parameters)
        guess = options.guess
        if isinstance(guess, Mapping):
            guess = {key: value for key, value in guess.items() if key != name}
        options = replace(options, free=[key for key in names if key != name], guess=guess)
        done = run_fit(options, lambda warning: None)
        number = find_number(done.model, name, done.base.robot)
        value = number.text(number.read(done.plant))
        remarks.append(f"{name} is held at {value}: the commands hardly tell it.")
    if wider := _widen_bounds(done):
        options = replace(options, bounds={**cli.read_value(options.bounds), **wider})
        done = run_fit(options, lambda warning: None)
        remarks.append(
            f"{', '.join(wider)} hit a bound, which was moved once, and the fit repeated"
        )
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


def within_bounds(
    f: Fitted, plant: str, bounds: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Return the numbers of a fit as far as another plant may have them."""
    space = make_space(plant, [p.name for p in f.parameters], bounds, f.base.robot)
    values = np.clip([p.value for p in f.parameters], space.lower, space.upper)
    return dict(zip(space.names, values.tolist(), strict=True))


def _of_logs(f: Fitted) -> dict[str, float]:
    """Return the numbers of single logs that a fit has found."""
    numbers = {}
    for p in f.parameters:
        number, at, _ = p.name.partition("@")
        if at and number in OF_A_LOG:
            numbers[p.name] = p.value
    return numbers
