"""The sections on chapter 3: models fitted to trajectory 4 and judged on all four, simulation times, accelerations.

The MuJoCo Husky of profile `thesis-lab` takes the place of the thesis' robot, whose measured motion is not published.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, FloatArray, Plant, State
from validation import store
from validation.fit.data import FittedParameter, Scored
from validation.fit.result import FitResult
from validation.fit.run import FitSearch, fit
from validation.fit.table import is_vague
from validation.plants.profile import load_profile, make_plant
from validation.replicate.events import median_and_spread, solutions_grid, solved_side_by_side
from validation.replicate.evidence import Context, Findings, Section, Table, searched
from validation.replicate.figures import draw_responses
from validation.thesis import published
from validation.thesis.verdicts import RULE_OF, Pair, Rule, Supposed

_PROFILE = "thesis-lab"
_FITTED_TO, _HELD_OUT = "traj4@mujoco", ("traj1", "traj2", "traj3")
_FITS: Mapping[str, tuple[str, str]] = {"coulomb": ("3.8", "3.9"), "improved": ("3.11", "3.12"), "linear": ("3.14", "3.15")}
"""Tables of each model: parameters and distances."""
_CALLED = {"coulomb": "Coulomb"}
"""Spelling of a model in sentences, if it is not its name."""
_NAMES: Mapping[str, str] = {
    "delay_u_s": "delay", "delay_w_s": "delay", "u_x": "u_x", "mu_c": "mu_c", "mu_s": "mu_s", "mu_d": "mu_d", "K_u": "k_u",
    "K_y": "k_y", "K_P_tau": "gain",
}  # fmt: skip
"""Names of the thesis' parameters in a fit, which has one delay for both of the thesis'."""
_METRICS: Mapping[str, Rule] = {**RULE_OF, "e_bend_ratio": "none"}
_TIMED = ("coulomb", "improved", "linear", "mujoco")
_STEP = (0.5, 0.5)
"""Steps of speed [m/s] and of yaw rate [rad/s] for the step responses, about as great as in the trajectories."""
_STEP_TIME = 4.0
"""Duration of a step response [s]."""
_CHATTER = 3.0
"""Fig. 3.33 shows numerical artefacts of the Coulomb model that the improved one does not have. This is taken to mean that
its yaw acceleration alternates at least this many times as often (with one added to both counts)."""


def _fit_section(model: str) -> Section:
    """Return the section that fits a model's parameters as Sec. 3.5.4-3.5.6 did."""
    parameters, distances = _FITS[model]
    called = _CALLED.get(model, model)

    def run(context: Context) -> Findings:
        settings = context.settings
        result = searched(
            context,
            "search",
            lambda search, progress: fit(
                model, _FITTED_TO, _PROFILE, held_out=_HELD_OUT, objective="path", population=settings.fit_population,
                generations=settings.fit_generations, progress=progress,
                search=FitSearch(**search, seed=settings.seed, method="jde"),
            ),
        )  # fmt: skip
        caption = (
            f"The {called} model fitted to trajectory 4 as the MuJoCo Husky drives it: the search, the parameters "
            "between their bounds with 95 % bars, their correlations, and the paths."
        )
        budget = f"{result.evaluations} simulations, {result.generations} generations of {settings.fit_population}"
        reduced = " (reduced: --quick)" if settings.quick else ""
        return Findings(
            {parameters: parameter_table(parameters, model, result), distances: distance_table(distances, model, result)},
            notes=(f"The search took {budget}{reduced}; cost {result.cost:.4g}, seed {result.seed}.", *result.remarks),
            pictures=(context.picture("fit", result.figure(), caption),),
            numbers={
                "cost": result.cost,
                "evaluations": result.evaluations,
                "parameters": store.plain({p.name: asdict(p) for p in result.parameters}),
            },
        )

    needs = ("quick", "seed", "fit_population", "fit_generations")
    return Section(f"fit-{model}", f"The {called} model, fitted", (parameters, distances), needs, run)


def parameter_table(number: str, model: str, result: FitResult) -> Table:
    """Return the thesis' parameters beside the fitted ones; below them, parameters that only the fit has."""
    found = {p.name: p for p in result.parameters}
    rows: dict[str, dict[str, Pair]] = {}
    for row, printed in published.table(number)["rows"].items():
        unit, value = printed["unit"], float(printed["value"])
        if row in _NAMES:
            rows[row] = {"value": _parameter_pair(value, unit, found[_NAMES[row]])}
        else:
            held = load_profile(_PROFILE).plants[model].drive.torque_limit
            rows[row] = {"value": Pair(value, held, "spread", unit, obstacle="taken from the thesis, not searched")}
    named = {_NAMES[row] for row in rows if row in _NAMES}
    rows |= {name: {"value": _parameter_pair(None, p.unit, p)} for name, p in found.items() if name not in named}
    return Table(f"Parameters of the {_CALLED.get(model, model)} model, fitted to trajectory 4", rows)


def _parameter_pair(value: float | None, unit: str, p: FittedParameter) -> Pair:
    obstacle = ""
    if p.at_bound:
        obstacle = "ours ended at a bound of its search"
    elif p.standard_error is None:
        obstacle = "no standard error could be estimated"
    elif is_vague(p):
        obstacle = "the motion hardly determines it: its 95 % interval takes up more than half of the bounds"
    return Pair(value, p.value, "spread", unit, p.standard_error, {"lower": p.lower, "upper": p.upper}, obstacle)


def distance_table(number: str, model: str, result: FitResult) -> Table:
    """Return the distances of the fitted model from the robot, for us the MuJoCo Husky, on trajectories 1-4."""
    printed = published.table(number)["rows"]
    scored: dict[str, Scored] = {s.label.partition("@")[0]: s for s in (*result.held_out, *result.train)}
    rows = {
        row: {
            metric: Pair(
                _number(numbers.get(metric)),
                _number(scored[row].metrics[metric]),
                rule,
                "m" if metric.endswith("_m") else "1",
            )
            for metric, rule in _METRICS.items()
        }
        for row, numbers in printed.items()
    }
    return Table(
        f"The {_CALLED.get(model, model)} model, fitted on trajectory 4, against the robot (ours: the MuJoCo Husky)", rows
    )


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _times(context: Context) -> Findings:
    """Take the time of a simulation of trajectory 4 (Sec. 3.6)."""
    profile, commands = load_profile(_PROFILE), TRAJECTORIES["traj4"].commands()
    walls = {name: _wall(make_plant(profile, name), commands, context.settings.repeats) for name in _TIMED}
    text = published.table("text")["rows"]
    hardware = "another machine and another simulator (Simulink)"
    rows: dict[str, dict[str, Pair]] = {}
    for name, (wall, spread) in walls.items():
        printed = text.get(f"{name}_simulation_time_s")
        value = float(printed["value"]) if printed else None
        beside = {"published_over_ours": value / wall} if value is not None else {}
        obstacle = hardware if value is not None else ""
        rows[name] = {"simulation_time_s": Pair(value, wall, "none", "s", spread, beside, obstacle)}
    solved = solved_side_by_side(TRAJECTORIES["traj4"], max(3, context.settings.repeats // 5))
    ratio, under = _ratio(walls), _ratio(solved)
    printed_ratio = 1.0 - 0.01 * float(text["simulation_time_reduction_percent"]["value"])
    supposed = Supposed(*under, "the models are solved with a variable step that stops at every change of a friction's sign")
    rows["improved against coulomb"] = {
        "time_ratio": Pair(printed_ratio, ratio[0], "distance", "1", ratio[1], supposed=supposed)
    }
    events = (
        f"The thesis gives the improved model {printed_ratio:.2f} of the Coulomb model's time. With a fixed step and "
        f"compiled loops it takes {ratio[0]:.2f}. What costs time is stopping at every change of a friction's sign: with "
        f"scipy's solve_ivp (Runge-Kutta 4/5, relative tolerance 1e-3), which locates them, it takes {under[0]:.2f}, since "
        "Coulomb friction chatters whenever the turn reverses, and the improved friction sticks. Tab. 3.7 gives a fixed "
        "step of 1 ms, so this is a supposition about Simulink's search for zero crossings."
    )
    note = (
        f"Medians of {context.settings.repeats} runs after one to warm up, {commands.duration:g} s of motion each, in "
        "processor time; the spread is half the distance between the quartiles. The planar models are stepped at 1 ms by "
        "compiled loops, the MuJoCo Husky at 2 ms. The thesis does not say how long its trajectory 4 is."
    )
    grids = {"The printed models, solved with changes of sign located": solutions_grid(solved)}
    return Findings({"Sec. 3.6": Table("Time to simulate trajectory 4", rows)}, grids, notes=(note, events))


def _ratio(walls: Mapping[str, Sequence[float]]) -> tuple[float, float]:
    """Return the improved model's time over the Coulomb model's, and its spread."""
    ratio = walls["improved"][0] / walls["coulomb"][0]
    return ratio, ratio * math.hypot(*(walls[name][1] / walls[name][0] for name in ("improved", "coulomb")))


def _wall(plant: Plant, commands: Commands, repeats: int) -> tuple[float, float]:
    """Return median and half the interquartile range of a run's processor time [s]."""
    plant.run(commands, State(), SAMPLE_DT)
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        plant.run(commands, State(), SAMPLE_DT)
        taken.append(time.process_time() - began)
    return median_and_spread(taken)


def _accelerations(context: Context) -> Findings:
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
            rows[name][f"{what}_delay_s"] = Pair(None, _number(delay), "none", "s")
            rows[name][f"{what}_rise_s"] = Pair(None, _number(rise), "none", "s")
    chatter = {name: 1.0 + (row["alternations"].ours or 0.0) for name, row in rows.items()}
    rows["coulomb over improved"] = {
        "alternations": Pair(None, chatter["coulomb"] / chatter["improved"], "at_least", beside={"at_least": _CHATTER})
    }
    figure = draw_responses(driven, steps, _STEP, profile.name)
    caption = (
        "Above, yaw acceleration on trajectory 4 where the turn reverses, at every physics step. Below, the responses to "
        "a step of speed and to a step of yaw rate, from rest."
    )
    notes = (
        "Alternations: physics steps of trajectory 4 at which the yaw acceleration has another sign than at the steps "
        "before and after. Delay: from the command to 10 % of the final value. Rise: from there to 90 %. Fig. 3.33 has "
        "no numbers. The thesis says that it shows artefacts with Coulomb friction and none with the improved friction; "
        f"this is taken to mean at least {_CHATTER:g} times as many alternations, with one added to both counts.",
    )
    table = Table("Yaw acceleration on trajectory 4, and step responses", rows)
    return Findings({"Fig. 3.33": table}, notes=notes, pictures=(context.picture("accelerations", figure, caption),))


def alternations(acceleration: FloatArray) -> int:
    """Return how many samples of an (M,) acceleration have another sign than both neighbours, as they do in chatter."""
    sign = np.sign(acceleration)
    return int(np.sum((sign[1:-1] * sign[:-2] < 0.0) & (sign[1:-1] * sign[2:] < 0.0)))


def delay_and_rise(t: Sequence[float] | FloatArray, answer: FloatArray) -> tuple[float, float]:
    """Return delay and rise of the response to a step at the first stamp, from rest.

    Args:
        t: (M,) stamps [s].
        answer: (M,) response; its mean over the last tenth is the final value.

    Returns:
        Time to 10 % of the final value [s], and from there to 90 % [s]; NaN for a response that stays at zero.
    """
    stamps, values = np.asarray(t, dtype=np.float64), np.asarray(answer, dtype=np.float64)
    final = float(np.mean(values[-max(1, len(values) // 10) :]))
    if not abs(final) > 1e-6:
        return float("nan"), float("nan")
    share = values / final

    def first(level: float) -> float:
        """Return the first time at which the response reaches a level, linear between samples."""
        k = int(np.argmax(share >= level))
        return float(np.interp(level, share[k - 1 : k + 1], stamps[k - 1 : k + 1])) if k else float(stamps[0])

    low, high = first(0.1), first(0.9)
    return low - float(stamps[0]), high - low


MODEL_SECTIONS = (
    *(_fit_section(model) for model in _FITS),
    Section("times", "Simulation times", ("Sec. 3.6",), ("repeats",), _times),
    Section("accelerations", "Acceleration curves", ("Fig. 3.33",), (), _accelerations),
)
"""The sections on chapter 3."""
