"""The cases of cases/ have right answers, and every able plant gets them (docs/why_drift.md)."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from ssmr.models.coulomb import CoulombParameters
from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.models.improved import ImprovedParameters
from ssmr.models.law import PLANAR_MODELS
from ssmr.models.linear import LinearParameters
from ssmr.robot.ground import turn_on_the_spot
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from tests.polygons import polygonal_turn
from validation.engines.body import EngineMissingError
from validation.engines.drake import DrakeBody
from validation.engines.ode import OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.planar import tyred_defaults
from validation.plants.table import ALL_PLANTS
from validation.simulator.calibration import Calibration
from validation.simulator.description import SCHEMA, Robot, parse_robot
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain

Table = Mapping[str, Any]

CASES: Mapping[str, Table] = {
    path.stem: tomllib.loads(path.read_text(encoding="utf-8"))
    for path in sorted((Path(__file__).resolve().parents[1] / "cases").glob("*.toml"))
}
ANSWERS: Mapping[str, tuple[Table, Table]] = {
    f"{name}.{answer['name']}": (case, answer)
    for name, case in CASES.items()
    for answer in case["answer"]
}

PLANAR = tuple(PLANAR_MODELS)
ENGINES = ("ode", "drake")
NO_SLIP = (
    "its sides do not slip sideways: "
    "yaw rate and wheel rates are linked by a half-track that is put in"
)
NO_FORCES = "it has no forces"
VISCOUS = "its friction is viscous"
LEVEL = "it knows level ground alone"
CIRCLE = "its friction is a circle"
CANNOT = (
    ("turn_*", PLANAR, NO_SLIP),
    ("steady_curve.*", PLANAR, NO_SLIP),
    (
        "motor_step.turn",
        ("four_wheel", "mujoco", *ENGINES),
        "its wheels slip sideways as forces make them",
    ),
    ("motor_step.*", ("kinematic",), NO_FORCES),
    ("tip_limit.*", PLANAR, "its loads do not shift"),
    ("side_slope.*", (*PLANAR, "four_wheel"), LEVEL),
    ("sliding_stop.*", ("kinematic",), NO_FORCES),
    ("sliding_stop.*", ("linear",), VISCOUS),
    ("energy.*", ("kinematic",), NO_FORCES),
    ("energy.*", ("linear",), VISCOUS),
    ("turn_on_the_spot.*_across", ("four_wheel", *ENGINES), CIRCLE),
    ("turn_on_lines.*", ("four_wheel",), "its tyres touch in one point"),
    ("turn_on_lines.even", ("mujoco", *ENGINES), "its cylinders touch at their ends"),
    ("turn_on_a_polygon.*", ("four_wheel", "drake"), CIRCLE),
    (
        "turn_on_a_polygon.*",
        ("mujoco",),
        "its soft contact smears a pyramid's corners (docs/why_drift.md)",
    ),
    ("turn_on_a_polygon.diamond", ("ode",), "its pyramid is a square"),
)
"""Which plants cannot have which answers, and why."""

LAG = {"mujoco": 0.0095}
"""Time by which a soft contact's friction lags [s]: it pushes where the tyre was
(docs/physics.md)."""


def possible(name: str, plant: str) -> bool:
    return not any(plant in plants and fnmatch(name, pattern) for pattern, plants, _ in CANNOT)


# ---------------------------------------------------------------------------------------- the
# answers, from the files alone
def steady(case: Table) -> Table:
    """Balance forces and moments of a robot whose rims have given speeds."""
    r = case["robot"]
    m = case["robot"]["mass_kg"]
    rims = case["motion"]["rim_speed_left_m_s"], case["motion"]["rim_speed_right_m_s"]
    x_c = r["com_ahead_m"]
    y_c = r["com_left_m"]
    h = r["com_height_m"]
    g = r["gravity_m_s2"]
    x = 0.5 * r["wheelbase_m"] * np.array([1, 1, -1, -1])
    y = 0.5 * r["track_m"] * np.array([1, -1, 1, -1])
    spin = 4.0 * r["wheel_inertia_kg_m2"] * np.mean(rims) / r["wheel_radius_m"]

    def left_over(motion: FloatArray) -> list[float]:
        v, q, w = motion
        force = m * np.array([-w * q - w * w * x_c, w * v - w * w * y_c])
        load = m * g / 4 + (x_c * m * g - h * force[0]) * x / r["wheelbase_m"] ** 2
        load = load + (y_c * m * g - h * force[1] - spin * w) * y / r["track_m"] ** 2
        a = v - w * y - np.where(y > 0, *rims)
        b = q + w * x
        f_x, f_y = (-case["ground"]["friction"] * load * part / np.hypot(a, b) for part in (a, b))
        return [
            f_x.sum() - force[0],
            f_y.sum() - force[1],
            ((x - x_c) * f_y - (y - y_c) * f_x).sum(),
        ]

    solution = fsolve(
        left_over, [np.mean(rims), 0.0, 0.5 * (rims[1] - rims[0]) / r["track_m"]], xtol=1e-13
    )
    return dict(zip(("v_x_m_s", "v_y_m_s", "yaw_rate_rad_s"), map(float, solution), strict=True))


def on_the_spot(case: Table, answer: Table) -> Table:
    r = case["robot"]
    mu = case["ground"]["friction"]
    k = answer["friction_ratio"] * case["robot"]["wheelbase_m"]
    side = (
        0.5
        * r["wheel_radius_m"]
        * mu
        * r["mass_kg"]
        * r["gravity_m_s2"]
        * k
        / math.hypot(k, r["track_m"])
    )
    return {"multiplier": 1.0 + (k / r["track_m"]) ** 2, "side_torque_N_m": side}


def on_lines(case: Table, answer: Table) -> Table:
    r = case["robot"]
    b = 0.5 * case["robot"]["wheelbase_m"]
    spread = (
        np.array([-1.0, 1.0]) if answer["name"] == "ends" else (np.arange(2000) + 0.5) / 1000 - 1.0
    )
    y = 0.5 * r["track_m"] + 0.5 * r["wheel_width_m"] * spread
    z = brentq(
        lambda z: float(((b * b + y * (y - z)) / np.hypot(y - z, b)).mean()),
        y.mean(),
        3.0 * y.mean(),
    )
    return {"multiplier": 2.0 * z / r["track_m"]}


def on_a_polygon(case: Table, answer: Table) -> Table:
    r = case["robot"]

    def multiplier(heading: float) -> float:
        return polygonal_turn(
            answer["name"], math.radians(heading), r["wheelbase_m"], r["track_m"]
        ).multiplier

    mean = np.mean([multiplier(heading) for heading in np.arange(0.5, 90.0, 1.0)])
    return {
        "multiplier": [multiplier(heading) for heading in answer["heading_deg"]],
        "mean_multiplier": mean,
    }


def motor_rates(case: Table, answer: Table) -> Table:
    r = case["robot"]
    drive = case["motion"]
    limit = drive["limit_N_m"]
    c = 0.5 * r["track_m"]
    side = 2.0 * (r["wheel_inertia_kg_m2"] + r["rotor_inertia_kg_m2"])
    radius = r["wheel_radius_m"]
    turned = r["yaw_inertia_kg_m2"] + 2.0 * side * c * drive["effective_half_track_m"] / radius**2
    if answer["name"] == "turn":
        return {"yaw_acceleration_rad_s2": 2.0 * c * limit / radius / turned}
    inertia = 0.5 * r["mass_kg"] * radius**2 + side

    def slope(t: float, now: FloatArray) -> list[float]:
        error = drive["wanted_rate_rad_s"] - now[0]
        growth = drive["integral_gain_N_m_rad"] * (error - now[1] / drive["dc_stiffness_N_m_s_rad"])
        torque = np.clip(drive["gain_N_m_s_rad"] * error + now[1], -limit, limit)
        return [torque / inertia, 0.0 if abs(now[1]) >= limit and growth * now[1] > 0.0 else growth]

    t = answer["t_s"]
    return {
        "rate_rad_s": solve_ivp(
            slope, (0.0, t[-1]), [0.0, 0.0], t_eval=t, max_step=5e-4, rtol=1e-8
        ).y[0]
    }


def plain(name: str, case: Table, answer: Table) -> Table:
    """The answers that are one line."""
    r = case["robot"]
    mu = case.get("ground", answer).get("friction")
    g = case["robot"]["gravity_m_s2"]
    if name == "sliding_stop":
        v = case["motion"]["speed_m_s"]
        return {"way_m": v * v / (2.0 * mu * g)}
    if name == "side_slope":
        slope = math.radians(answer["slope_deg"])
        assert (slope > math.atan(mu)) == (answer["name"] == "above")
        return {"acceleration_m_s2": max(g * (math.sin(slope) - mu * math.cos(slope)), 0.0)}
    if name == "tip_limit":
        return {"trailing_share": max(0.5 - mu * r["com_height_m"] / r["track_m"], 0.0)}
    spun = 4.0 * (r["wheel_inertia_kg_m2"] + r["rotor_inertia_kg_m2"]) / r["wheel_radius_m"] ** 2
    return {
        "moved_mass_kg": r["mass_kg"] + spun,
        "resistance_N": case["ground"]["rolling_resistance"] * r["mass_kg"] * g,
    }


def recomputed(name: str, case: Table, answer: Table) -> Table:
    special = {
        "turn_on_the_spot": on_the_spot,
        "turn_on_lines": on_lines,
        "turn_on_a_polygon": on_a_polygon,
    }
    special["motor_step"] = motor_rates
    if name in special:
        return special[name](case, answer)
    return steady(case) if answer["name"] == "steady" else plain(name, case, answer)


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_follows_from_the_numbers_of_its_file(name: str) -> None:
    case, answer = ANSWERS[name]
    for key, wanted in recomputed(name.split(".")[0], case, answer).items():
        assert answer[key] == pytest.approx(wanted, rel=1e-5, abs=1e-9), key


def test_the_librarys_closed_form_of_a_turn_has_the_same_answers() -> None:
    for name in ("turn_on_the_spot.more_across", "turn_on_lines.ends"):
        case, answer = ANSWERS[name]
        r = case["robot"]
        width = 0.5 * case["robot"]["wheel_width_m"] if "lines" in name else 0.0
        ratio = answer.get("friction_ratio", 1.0)
        measured = turn_on_the_spot(r["wheelbase_m"], r["track_m"], ratio=ratio, half_width=width)
        assert measured.multiplier == pytest.approx(answer["multiplier"], rel=1e-5)


# -----------------------------------------------------------------------------------------------
# the plants, from the files
def robot_of(r: Table) -> Robot:
    """The robot of a file; its base is whatever leaves the whole robot's numbers to four wheels."""
    radius = r["wheel_radius_m"]
    lever = 0.25 * (r["wheelbase_m"] ** 2 + r["track_m"] ** 2)
    share = 1.0 - 4.0 * r["wheel_mass_kg"] / r["mass_kg"]
    across = 0.56 * r["wheel_inertia_kg_m2"]
    yaw = r["yaw_inertia_kg_m2"] - 4.0 * (across + r["wheel_mass_kg"] * lever)
    com = [r["com_ahead_m"] / share, r["com_left_m"] / share, (r["com_height_m"] - radius) / share]
    geometry = {
        name: r[f"{name}_m"] for name in ("wheelbase", "track", "wheel_radius", "wheel_width")
    }
    masses = {
        "total": r["mass_kg"],
        "wheel": r["wheel_mass_kg"],
        "wheel_inertia": [across, r["wheel_inertia_kg_m2"]],
    }
    masses |= {"com": com, "inertia": [0.3 * yaw, 0.85 * yaw, yaw]}
    return parse_robot(
        {
            "schema": SCHEMA,
            "name": "case",
            "geometry": {**geometry, "axle_height": 0.0},
            "mass": masses,
        }
    )


def plant_of(plant: str, name: str, drive: Drive, dt: float, gain: float) -> Plant:
    """The plant with the numbers of a case."""
    case, answer = ANSWERS[name]
    r = case["robot"]
    ground = {**case.get("ground", {}), **answer}
    inertia = r["rotor_inertia_kg_m2"]
    kind = name.split(".")[0]
    resistance = ground.get("rolling_resistance", 0.0)
    if plant in PLANAR:
        spin = 2.0 * (inertia + r["wheel_inertia_kg_m2"])
        c = 0.5 * r["track_m"]
        along = resistance
        if kind == "sliding_stop":
            spin = 0.0
            along = ground["friction"]
        laws = {
            "coulomb": CoulombParameters(along, 0.0, gain),
            "improved": ImprovedParameters(along, 0.0, 0.0, gain),
        }
        laws["linear"] = LinearParameters(0.0, 0.0, gain / r["wheel_radius_m"])
        sizes = {
            "mass": r["mass_kg"],
            "yaw_inertia": r["yaw_inertia_kg_m2"],
            "wheel_radius": r["wheel_radius_m"],
        }
        linked = case["motion"].get("effective_half_track_m", c)
        vehicle = Vehicle(**sizes, spin_inertia=spin, half_track=c, effective_half_track=linked)
        return PlanarPlant(PlanarModel(laws[plant], vehicle, drive), dt)
    robot = robot_of(r)
    common = {"friction": ground["friction"], "armature": inertia, "gain": gain}
    if plant == "four_wheel":
        stiff = {"stiffness_x": 300.0, "stiffness_y": 300.0, "rolling_resistance": resistance}
        return FourWheelPlant(replace(tyred_defaults(robot), **common, **stiff), drive)
    ratio = ground.get("friction_ratio", 1.0)
    shape = "cylinder" if kind == "turn_on_lines" else "ellipsoid" if ratio == 1.0 else "capsule"
    common |= {
        "timestep": dt,
        "rolling_resistance": resistance,
        "friction_ratio": ratio,
        "wheel_shape": shape,
    }
    calibration = Calibration.of(robot, **common)
    slope = Terrain(math.radians(answer["slope_deg"])) if "slope_deg" in answer else FLAT
    if plant == "mujoco":
        return MujocoPlant(calibration, drive, terrain=slope)
    law = OdeSettings("pyramid", "world") if kind == "turn_on_a_polygon" else OdeSettings()
    try:
        return EnginePlant(
            plant,
            partial(OdeBody, settings=law) if plant == "ode" else DrakeBody,
            calibration,
            drive,
            slope,
        )
    except EngineMissingError as error:
        pytest.skip(str(error))


def driven(
    plant: str,
    name: str,
    values: Any,
    kind: Any = "twist",
    dt: float = 0.002,
    start: State | None = None,
    **drive: Any,
) -> Trajectory:
    """Drive a case with commands of 50 ms; only `drive` delays or limits them."""
    r = ANSWERS[name][0]["robot"]
    free = {"delay_v": 0.0, "delay_w": 0.0, "v_max": 50.0, "w_max": 50.0, "torque_limit": 1e4}
    sizes = {"command_half_track": 0.5 * r["track_m"], "command_radius": r["wheel_radius_m"]}
    gain = drive.pop("gain", 118.0)
    made = plant_of(plant, name, Drive(**{**free, **sizes, **drive}), dt, gain)
    return made.run(
        Commands(0.05, np.asarray(values, dtype=np.float64), kind), start or State(), dt
    )


def spun(plant: str, name: str, case: Table, answer: Table, dt: float) -> Table:
    """Turn on the spot from rest.

    The mean multiplier and torque, or by heading and over a quarter turn.
    """
    r = case["robot"]
    rim = 2.0 * case["motion"]["rim_speed_m_s"] / case["robot"]["track_m"]
    slow = "heading_deg" in answer
    motion = driven(plant, name, [[0.0, rim]] * (340 if slow else 80), dt=dt)
    late = motion.t > 2.0
    rims = r["wheel_radius_m"] * np.diff(motion.wheels[late])[:, 0]
    rate = motion.twist[late, 2]
    multiplier = rims / (r["track_m"] * rate)
    if not slow:
        return {
            "multiplier": multiplier.mean(),
            "side_torque_N_m": motion.channels["torque_N_m"][late, 1].mean(),
        }
    heading = np.degrees(motion.yaw[late])
    quarter = motion.yaw[late] <= motion.yaw[late][0] + 0.5 * math.pi
    assert not quarter[-1]
    near = [np.abs((heading - h + 45.0) % 90.0 - 45.0) < 0.5 for h in answer["heading_deg"]]
    mean = rims[quarter].mean() * np.count_nonzero(quarter) * dt / (r["track_m"] * 0.5 * math.pi)
    return {"multiplier": [np.median(multiplier[k]) for k in near], "mean_multiplier": mean}


def rolled(plant: str, name: str, case: Table, answer: Table, dt: float) -> Table:
    """Drive with given rims.

    The mean twist of the last second, at the place where a lagging contact takes it.
    """
    r = case["robot"]
    commanded = case["motion"]
    rims = np.array([commanded["rim_speed_left_m_s"], commanded["rim_speed_right_m_s"]])
    rates = rims / r["wheel_radius_m"]
    start = State(v_x=float(rims.mean()), wheel_left=float(rates[0]), wheel_right=float(rates[1]))
    motion = driven(plant, name, [rates] * 60, "wheels", dt, start)
    v_x, v_y, rate = motion.twist[motion.t > 2.0].mean(axis=0)
    moved = rate * LAG.get(plant, 0.0)
    multiplier = float(np.diff(rims)[0]) / (r["track_m"] * rate)
    return {
        "v_x_m_s": v_x - moved * v_y,
        "v_y_m_s": v_y + moved * v_x,
        "yaw_rate_rad_s": rate,
        "multiplier": multiplier,
    }


def slid(plant: str, name: str, case: Table, answer: Table, dt: float) -> Table:
    """Slide with blocked wheels, or with free ones whose rolling resistance is the friction."""
    v = case["motion"]["speed_m_s"]
    blocked = plant in ENGINES or plant == "mujoco"
    start = State(v_x=v) if plant in PLANAR else State(v_y=-v)
    if "slope_deg" in answer and plant != "four_wheel":
        start = State(yaw=-0.5 * math.pi)
    hold: dict[str, float] = {"gain": 1e-9} if plant in PLANAR else {"gear_loss": 1e3}
    motion = driven(
        plant,
        name,
        [[0.0, 0.0]] * 10,
        "wheels" if blocked else "twist",
        dt,
        start,
        **({} if blocked else hold),
    )
    if "way_m" in answer:
        return {"way_m": float(np.hypot(*motion.xy[-1]))}
    loads = motion.channels["wheel_load_N"][(motion.t > 0.2) & (motion.t < 0.35)].mean(axis=0)
    return {"trailing_share": (loads[0] + loads[2]) / loads.sum()}


def held(plant: str, name: str, case: Table, answer: Table, dt: float) -> Table:
    motion = driven(plant, name, [[0.0, 0.0]] * 40, dt=dt, start=State(yaw=0.5 * math.pi))
    speed = np.hypot(*motion.twist[:, :2].T)
    return {
        "acceleration_m_s2": speed[-1] - speed[motion.t >= 1.0][0],
        "way_m": np.hypot(*(motion.xy[-1] - motion.xy[0])),
    }


def stepped(plant: str, name: str, case: Table, answer: Table, dt: float) -> Table:
    """Ask for a step of the wheel rates.

    Straight ahead with the integral part, on the spot at the limit without it.
    """
    commanded = case["motion"]
    straight = answer["name"] == "straight"
    loop = {"gain": commanded["gain_N_m_s_rad"], "torque_limit": 0.5 * commanded["limit_N_m"]}
    loop |= (
        {
            "integral_gain": commanded["integral_gain_N_m_rad"],
            "dc_stiffness": commanded["dc_stiffness_N_m_s_rad"],
        }
        if straight
        else {}
    )
    twist = (
        [commanded["wanted_rate_rad_s"] * case["robot"]["wheel_radius_m"], 0.0]
        if straight
        else [0.0, 20.0]
    )
    motion = driven(plant, name, [twist] * (32 if straight else 2), dt=dt, **loop)
    if straight:
        return {
            "rate_rad_s": motion.wheels[np.round(np.array(answer["t_s"]) / dt).astype(int)].mean(
                axis=1
            )
        }
    return {"yaw_acceleration_rad_s2": motion.twist[-1, 2] / motion.t[-1]}


def worked(plant: str, name: str, case: Table, answer: Table, dt: float) -> Table:
    """Start and brake.

    The work of the motors less what the answer says of it, and the greatest that it says.
    """
    commanded = case["motion"]
    half = round(case["motion"]["brake_at_s"] / 0.05)
    twists = [[commanded["speed_m_s"], 0.0]] * half + [[0.0, 0.0]] * half
    motion = driven(
        plant, name, twists, dt=dt, acceleration_v=commanded["acceleration_m_s2"], gain=40.0
    )
    power = motion.channels["torque_N_m"][1:] * 0.5 * (motion.wheels[1:] + motion.wheels[:-1])
    work = np.concatenate([[0.0], np.cumsum(power.sum(axis=1)) * dt])
    wanted = (
        0.5 * answer["moved_mass_kg"] * motion.twist[:, 0] ** 2
        + answer["resistance_N"] * motion.pose[:, 0]
    )
    return {"work": 1.0 + np.abs(work - wanted).max() / wanted.max()}


DRIVES = {
    "turn_on_the_spot": spun,
    "turn_on_a_polygon": spun,
    "turn_off_the_middle": rolled,
    "turn_on_lines": rolled,
    "steady_curve": rolled,
    "sliding_stop": slid,
    "tip_limit": slid,
    "side_slope": held,
    "motor_step": stepped,
    "energy": worked,
}


def errors(name: str, plant: str, dt: float) -> dict[str, tuple[float, float]]:
    """The greatest error of each number of an answer as a plant has it, and how great it may be."""
    case, answer = ANSWERS[name]
    measured = DRIVES[name.split(".")[0]](plant, name, case, answer, dt)
    out = {}
    for key, limit in case["tolerance"].items():
        if key in answer or key == "work":
            wanted = np.array(answer.get(key, 1.0), dtype=np.float64)
            off = np.abs(np.array(measured[key]) - wanted) / (
                np.abs(wanted) if "relative" in limit else 1.0
            )
            out[key] = float(off.max()), float(next(iter(limit.values())))
    return out


@pytest.mark.parametrize(
    ("name", "plant"), [(n, p) for n in ANSWERS for p in ALL_PLANTS if possible(n, p)]
)
def test_a_plant_gets_the_answer(name: str, plant: str) -> None:
    for key, (error, limit) in errors(
        name, plant, 0.001 if name.startswith("energy") else 0.002
    ).items():
        assert error <= limit, key


@pytest.mark.parametrize(
    ("name", "plant", "key"),
    [
        ("sliding_stop.stop", "ode", "way_m"),
        ("motor_step.straight", "improved", "rate_rad_s"),
        ("energy.straight", "mujoco", "work"),
    ],
)
def test_an_error_is_of_the_order_that_the_file_says(name: str, plant: str, key: str) -> None:
    coarse, fine = (errors(name, plant, dt)[key][0] for dt in (0.002, 0.001))
    assert math.log2(coarse / fine) == pytest.approx(
        ANSWERS[name][0]["convergence"]["order"], abs=0.2
    )


FAULTS = {
    "friction": ("turn_on_the_spot.isotropic", "ground", "friction", 1.02),
    "height": ("tip_limit.below", "robot", "com_height_m", 1.03),
    "weight": ("energy.straight", "robot", "mass_kg", 1.03),
    "resistance": ("energy.straight", "ground", "rolling_resistance", 1.03),
    "rotors": ("motor_step.straight", "robot", "rotor_inertia_kg_m2", 1.05),
    "base": ("steady_curve.steady", "robot", "wheelbase_m", 1.02),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_plant_with_a_small_fault_fails(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, section, key, factor = FAULTS[fault]
    case, answer = ANSWERS[name]
    wrong = {**case, section: {**case[section], key: factor * case[section][key]}}
    monkeypatch.setitem(ANSWERS, name, (wrong, answer))  # type: ignore[arg-type]
    assert any(error > limit for error, limit in errors(name, "four_wheel", 0.001).values())
