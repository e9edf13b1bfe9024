"""Chapter 3: models fitted to trajectory 4 and judged on all four, simulation times, accelerations.

The MuJoCo Husky of profile `thesis-lab` takes the place of the thesis' robot, whose measured motion is not published.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from validation.fit import fit
from validation.plants.profile import load_profile, make_plant
from validation.replicate.chapters import Findings, Section, Task
from validation.report.drawing import QUIET, Row, draw_section, ink_of, side_by_side, text_row
from validation.thesis import published
from validation.thesis.verdicts import RULE_OF, Pair, Rows, Rule

_PROFILE = "thesis-lab"
_FITS: Mapping[str, tuple[str, str]] = {"coulomb": ("3.8", "3.9"), "improved": ("3.11", "3.12"), "linear": ("3.14", "3.15")}
"""Tables of each model: parameters and distances."""
_NAMES: Mapping[str, str] = {
    "delay_u_s": "delay", "delay_w_s": "delay", "u_x": "u_x", "mu_c": "mu_c", "mu_s": "mu_s", "mu_d": "mu_d", "K_u": "k_u",
    "K_y": "k_y", "K_P_tau": "gain",
}  # fmt: skip
"""Names of the thesis' parameters in a fit, which has one delay for both of the thesis'."""
_RULES: Mapping[str, Rule] = {**RULE_OF, "e_bend_ratio": "none"}
_VAGUE = 0.5
"""A parameter is hardly determined if its 95 % interval takes up more than this share of its bounds [1]."""
_TIMED = ("coulomb", "improved", "linear", "mujoco")
_STEP = (0.5, 0.5)
"""Steps of speed [m/s] and of yaw rate [rad/s] for the step responses, about as great as in the trajectories."""
_STEP_TIME = 4.0
"""Duration of a step response [s]."""
_CHATTER = 3.0
"""Fig. 3.33 shows numerical artefacts of the Coulomb model that the improved one does not have. This is taken to mean that
its yaw acceleration alternates at least this many times as often (with one added to both counts)."""
_SHOWN = 0.5
"""Duration of the part of the trajectory that is drawn, around a reversal of the turn [s]."""


def _fitted(model: str, task: Task) -> Findings:
    """Fit a model's parameters as Sec. 3.5.4-3.5.6 did."""
    (population, generations), (parameters, distances) = task.budget.fit, _FITS[model]
    found = fit(
        model, "traj4@mujoco", _PROFILE, held_out=("traj1", "traj2", "traj3"), objective="path", population=population,
        generations=generations, search="jde", seed=task.seed, workers=task.workers, progress=task.progress,
    ).as_dict()  # fmt: skip
    if found["status"] == "interrupted":
        raise KeyboardInterrupt
    words = {
        "called": "Coulomb" if model == "coulomb" else model,
        "parameters": parameters,
        "distances": distances,
        "population": population,
        "remarks": "\n".join(f"- {note}" for note in found["notes"]),
        **{name: found[name] for name in ("evaluations", "generations", "cost", "seed")},
    }
    return Findings(
        {parameters: parameter_rows(parameters, model, found), distances: distance_rows(distances, found)}, words
    )


def parameter_rows(number: str, model: str, fitted: Mapping[str, Any]) -> Rows:
    """Return the thesis' parameters beside those of fit.json; below them, those that only the fit has."""
    found: Mapping[str, Mapping[str, Any]] = fitted["parameters"]
    rows: dict[str, dict[str, Pair]] = {}
    for row, printed in published.table(number)["rows"].items():
        unit, value = printed["unit"], float(printed["value"])
        if row in _NAMES:
            rows[row] = {"value": _parameter_pair(value, unit, found[_NAMES[row]])}
        else:
            held = load_profile(_PROFILE).plants[model].drive.torque_limit
            rows[row] = {"value": Pair(value, held, "spread", unit, obstacle="taken from the thesis, not searched")}
    named = {_NAMES[row] for row in rows if row in _NAMES}
    return rows | {name: {"value": _parameter_pair(None, p["unit"], p)} for name, p in found.items() if name not in named}


def _parameter_pair(printed: float | None, unit: str, p: Mapping[str, Any]) -> Pair:
    ends, bounds, obstacle = p["interval_95"], (p["lower"], p["upper"]), ""
    if p["at_bound"]:
        obstacle = "ours ended at a bound of its search"
    elif ends is None:
        obstacle = "no standard error could be estimated"
    else:
        width, whole = (np.ptp(np.log(x) if p["scale"] == "log" else x) for x in (ends, bounds))
        if width > _VAGUE * whole:
            obstacle = "the motion hardly determines it: its 95 % interval takes up more than half of the bounds"
    beside = dict(zip(("lower", "upper"), bounds, strict=True))
    return Pair(printed, p["value"], "spread", unit, p["standard_error"], beside, obstacle)


def distance_rows(number: str, fitted: Mapping[str, Any]) -> Rows:
    """Return the distances of the fitted model from the robot, for us the MuJoCo Husky, on trajectories 1-4."""
    scored = {name.partition("@")[0]: metrics for name, metrics in fitted["held_out"].items()} | {"traj4": fitted["train"]}
    return {
        row: {m: Pair(printed.get(m), scored[row][m], rule, "m" if m.endswith("_m") else "1") for m, rule in _RULES.items()}
        for row, printed in published.table(number)["rows"].items()
    }


def _times(task: Task) -> Findings:
    """Take the time of a simulation of trajectory 4 (Sec. 3.6)."""
    profile, commands = load_profile(_PROFILE), TRAJECTORIES["traj4"].commands()
    walls = {name: _wall(make_plant(profile, name), commands, task.budget.repeats) for name in _TIMED}
    text = published.table("text")["rows"]
    rows: dict[str, dict[str, Pair]] = {}
    for name, (wall, spread) in walls.items():
        printed = text.get(f"{name}_simulation_time_s", {}).get("value")
        obstacle = "" if printed is None else "another machine and another simulator (Simulink)"
        beside = {} if printed is None else {"published_over_ours": printed / wall}
        rows[name] = {"simulation_time_s": Pair(printed, wall, "none", "s", spread, beside, obstacle)}
    ratio = walls["improved"][0] / walls["coulomb"][0]
    spread = ratio * math.hypot(*(walls[name][1] / walls[name][0] for name in ("improved", "coulomb")))
    printed_ratio = 1.0 - 0.01 * published.value("text", "simulation_time_reduction_percent")
    rows["improved against coulomb"] = {"time_ratio": Pair(printed_ratio, ratio, "distance", "1", spread)}
    words = {"repeats": task.budget.repeats, "duration": commands.duration, "printed": printed_ratio, "ratio": ratio}
    return Findings({"Sec. 3.6": rows}, words)


def _wall(plant: Plant, commands: Commands, repeats: int) -> tuple[float, float]:
    """Return median and half the interquartile range of a run's processor time [s]."""
    plant.run(commands, State(), SAMPLE_DT)
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        plant.run(commands, State(), SAMPLE_DT)
        taken.append(time.process_time() - began)
    low, median, high = np.percentile(taken, (25.0, 50.0, 75.0))
    return float(median), float(0.5 * (high - low))


def _accelerations(task: Task) -> Findings:
    """Find yaw accelerations on trajectory 4 (Fig. 3.33), and delay and rise of step responses."""
    profile = load_profile(_PROFILE)
    plants = {name: make_plant(profile, name) for name in _TIMED}
    driven = {name: plant.run(TRAJECTORIES["traj4"].commands(), State(), plant.dt) for name, plant in plants.items()}
    steps = []
    for command in np.diag(_STEP):
        commands = Commands(COMMAND_PERIOD, np.tile(command, (round(_STEP_TIME / COMMAND_PERIOD), 1)))
        steps.append({name: plant.run(commands, State(), SAMPLE_DT) for name, plant in plants.items()})
    rows: dict[str, dict[str, Pair]] = {}
    for name in _TIMED:
        n = alternations(driven[name].channels["yaw_acceleration_rad_s2"])
        rows[name] = {"alternations": Pair(None, float(n), "none")}
        for k, (what, column) in enumerate((("speed", 0), ("yaw_rate", 2))):
            delay, rise = delay_and_rise(steps[k][name].t, steps[k][name].twist[:, column])
            rows[name][f"{what}_delay_s"] = Pair(None, delay, "none", "s")
            rows[name][f"{what}_rise_s"] = Pair(None, rise, "none", "s")
    chatter = {name: 1.0 + (row["alternations"].ours or 0.0) for name, row in rows.items()}
    rows["coulomb over improved"] = {
        "alternations": Pair(None, chatter["coulomb"] / chatter["improved"], "at_least", beside={"at_least": _CHATTER})
    }
    return Findings({"Fig. 3.33": rows}, {"chatter": _CHATTER}, panels=_responses(driven, steps))


def alternations(acceleration: FloatArray) -> int:
    """Return how many samples of an (M,) acceleration have another sign than both neighbours, as they do in chatter."""
    sign = np.sign(acceleration)
    return int(np.sum((sign[1:-1] * sign[:-2] < 0.0) & (sign[1:-1] * sign[2:] < 0.0)))


def delay_and_rise(t: FloatArray, answer: FloatArray) -> tuple[float | None, float | None]:
    """Return delay and rise of the response to a step at the first stamp, from rest.

    Args:
        t: (M,) stamps [s].
        answer: (M,) response; its mean over the last tenth is the final value.

    Returns:
        Time to 10 % of the final value [s], and from there to 90 % [s]; None for a response that stays at zero.
    """
    final = float(np.mean(answer[-max(1, len(answer) // 10) :]))
    if not abs(final) > 1e-6:
        return None, None
    share = answer / final

    def first(level: float) -> float:
        """Return the first time at which the response reaches a level, linear between samples."""
        k = int(np.argmax(share >= level))
        return float(np.interp(level, share[k - 1 : k + 1], t[k - 1 : k + 1])) if k else float(t[0])

    low, high = first(0.1), first(0.9)
    return low - float(t[0]), high - low


def _responses(driven: Mapping[str, Trajectory], steps: Sequence[Mapping[str, Trajectory]]) -> list[Row]:
    """Return the accelerations of each plant where the first one's turn reverses, and below them the step responses."""
    first = next(iter(driven.values()))
    crossings = first.t[:-1][first.twist[1:, 2] * first.twist[:-1, 2] < 0.0]
    middle = float(crossings[np.argmin(np.abs(crossings - 0.5 * first.t[-1]))])
    seen = {name: np.abs(motion.t - middle) <= 0.5 * _SHOWN for name, motion in driven.items()}
    values = {name: motion.channels["yaw_acceleration_rad_s2"][seen[name]] for name, motion in driven.items()}
    reach = 1.06 * max(float(np.abs(each).max()) for each in values.values())

    def acceleration(name: str, ax: Axes) -> None:
        ax.plot(driven[name].t[seen[name]], values[name], color=ink_of(name), linewidth=1.0, gid=name)
        ax.set(title=name, ylim=(-reach, reach), xlabel="time [s]")

    def step(k: int, column: int, title: str, ax: Axes) -> None:
        for name, motion in steps[k].items():
            ax.plot(motion.t, motion.twist[:, column], color=ink_of(name), label=name, gid=name)
        ax.axhline(_STEP[k], color=QUIET, linewidth=1.0, linestyle=(0.0, (4.0, 2.0)), label="command")
        ax.set(title=title, xlim=(0.0, 1.5), xlabel="time since the command [s]")
        ax.legend(fontsize=8.0)

    heading = "Yaw acceleration [rad/s²] on trajectory 4, where the turn reverses, at every physics step; and step responses"
    below = [partial(step, 0, 0, "speed [m/s]"), partial(step, 1, 2, "yaw rate [rad/s]")]
    return [
        text_row(0.4, partial(draw_section, heading)),
        side_by_side(3.0, [partial(acceleration, name) for name in driven]),
        side_by_side(3.0, below),
    ]


MODEL_SECTIONS = (
    *(Section(f"fit-{model}", tables, partial(_fitted, model)) for model, tables in _FITS.items()),
    Section("times", ("Sec. 3.6",), _times),
    Section("accelerations", ("Fig. 3.33",), _accelerations),
)
"""The sections on chapter 3."""
