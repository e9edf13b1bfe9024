"""Laws of physics hold for every robot, shipped or drawn at random.

Tests/test_husky_physics.py tests the Husky further.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, State
from tests import robot_measures as measures
from tests.robots import HUSKY, documents, scaled
from validation import load_robot
from validation.plants.profile import bare_profile, load_profile, make_plant
from validation.simulator.calibration import Calibration
from validation.simulator.description import ROTOR_SHARE, parse_robot, shipped_robots
from validation.simulator.health import apparent_mass
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import Terrain

SIMILAR = 1e-7
"""Greatest difference of similar motions over their size: rounding, with a solver that is given no
tolerance."""

TURN_ERROR = 0.02
"""Relative, of the multiplier against its closed form, where that hardly depends on loads that the
turn itself shifts: the skidding tyres' radius takes half a per cent."""
CALM = 0.02
"""Sensitivity to such loads (`load_sensitivity`) up to which that holds. Of 500 drawn robots, 410
are calmer."""
SOFTNESS = 0.01
"""The error, relative, that comes on top of the sensitivity of others."""
WEIGHT = 1e-6
"""Greatest relative error of the loads' sum at rest, which the constraint solver's tolerance
leaves."""
RIPPLE = 1e-3
LOAD_DEVIATION = 1e-3
"""Greatest relative variation of the yaw rate and of the loads in a steady turn; a yaw rate that
loads decide varies by its sensitivity to them times that."""
STEP_SPREAD = 1e-4
"""Relative, between time steps: steady turning is a fixed point of the simulation, which robots
that barely turn approach so slowly that 2e-5 are left when it is measured."""
CREEP = 7e-5
"""Down a slope of 8 degrees, over sqrt(g wheel radius) [1]; 0.09 mm/s for a Husky."""
STOP_ERROR = 0.035
STEADY = 0.7
"""Greatest relative error of a slide's length; tyres that begin to slide rise. It holds for robots
that come no nearer to lifting wheels than 0.7."""
ROLLING = 1e-5
REST_LOADS = 0.05
"""Greatest errors of the rolling radius and of a wheel's load at rest, over a quarter of the
weight: contact stiffens with load, so with the centre of mass far off towards a corner the four
springs are not alike."""
SAME = 1e-3
"""Between two motors with belts and four motors [m, rad and relative]: a belt is a soft
constraint."""
SHIPPED = shipped_robots()

DRAWN = settings(derandomize=True, deadline=None, phases=[Phase.explicit, Phase.generate])
"""The same robots are drawn in each run. One that fails is shown as it was drawn: each try to
simplify it costs a second."""

DRIVES: dict[str, dict[str, float]] = {
    "proportional": {
        "torque_limit": math.inf,
        "delay_v": 0.2,
        "delay_w": 0.1,
        "hold": 0.05,
        "v_max": 1.0,
        "w_max": 2.0,
        "acceleration_v": 2.0,
        "acceleration_w": 5.0,
        "wheel_lag": 0.02,
        "command_radius": 0.165,
    },
    "integral": {
        "torque_limit": 60.0,
        "no_load_rate": 30.0,
        "gear_loss": 2.0,
        "integral_gain": 800.0,
        "dc_stiffness": 1900.0,
        "delay_v": 0.0,
        "delay_w": 0.0,
        "hold": 0.05,
        "command_ramp": 0.05,
        "command_radius": 0.165,
    },
}
"""Drives of a robot of the Husky's size."""


def motion(
    document: dict[str, Any], drive: dict[str, float], length: float, mass: float, given_rates: bool
) -> FloatArray:
    """Drive a Husky enlarged `length` times in space and root `length` times in time.

    Returns:
        (M, 10) place over wheel radius, yaw, wheel rates times the unit of time, loads over a
        quarter of the weight, and torques over weight and wheel radius, which are left out where
        rates are given.
    """
    time = math.sqrt(length)
    torque = mass * length
    factors = {
        "v_max": time,
        "w_max": 1.0 / time,
        "acceleration_v": 1.0,
        "acceleration_w": 1.0 / length,
        "command_half_track": length,
        "command_radius": length,
        "torque_limit": torque,
        "no_load_rate": 1.0 / time,
        "gear_loss": torque,
        "integral_gain": torque,
        "dc_stiffness": torque * time,
    }
    robot = parse_robot(scaled(document, length, mass))
    calibration = Calibration.of(
        robot, timestep=0.002 * time, rolling_resistance=0.02, radius_difference=0.001 * length
    )
    plant = MujocoPlant(
        calibration,
        Drive(**{name: value * factors.get(name, time) for name, value in drive.items()}),
        settings=PhysicsSettings(solver="Newton"),
    )
    for model in (plant.model, plant._prescribed):
        model.opt.tolerance = 0.0
    twists = TRAJECTORIES["traj4"].commands().values[:120]
    commands = Commands(0.05 * time, twists * [time, 1.0 / time])
    if given_rates:
        commands = Commands(
            0.05 * time,
            4.0 / time * np.column_stack([twists[:, 0], twists[:, 0] + twists[:, 1]]),
            "wheels",
        )
    measured = plant.run(commands, State(), 0.05 * time)
    radius = robot.wheel_radius
    weight = calibration.mass * 9.81
    torques = measured.channels.get("torque_N_m", np.zeros((len(measured), 2)))
    return np.column_stack(
        [
            measured.xy / radius,
            measured.yaw,
            measured.wheels * math.sqrt(radius),
            measured.channels["wheel_load_N"] / (0.25 * weight),
            torques.sum(axis=1) / (weight * radius),
        ]
    )


@settings(DRAWN, max_examples=8)
@given(
    documents(),
    st.sampled_from(list(DRIVES)),
    st.floats(0.25, 4.0),
    st.floats(0.1, 10.0),
    st.booleans(),
)
def test_similar_robots_move_alike(
    document: dict[str, Any], kind: str, length: float, mass: float, given_rates: bool
) -> None:
    """Froude's similarity: lengths grow by a factor, times by its root, masses by any factor.

    Where a number of one robot's size stood in the composed model, the contacts or the motors,
    these would part.
    """
    document = scaled(
        document, 0.1651 / document["geometry"]["wheel_radius"], 73.3 / document["mass"]["total"]
    )
    drive = {**DRIVES[kind], "command_half_track": 0.6 * document["geometry"]["track"]}
    one, other = (
        motion(document, drive, *factors, given_rates) for factors in ((1.0, 1.0), (length, mass))
    )
    # wheels that turn at given rates take great torques
    size = np.maximum(np.abs(one).max(axis=0), 1.0)
    assert np.abs((one - other) / size).max() < SIMILAR
    assert np.hypot(*one[-1, :2]) > 1.0


@pytest.mark.parametrize("profile", ["thesis-lab", "husky-tile"])
def test_the_composed_husky_is_the_hand_made_one(profile: str) -> None:
    """Without models/husky.xml, the Husky's numbers alone make the same robot."""
    section = load_profile(profile).plants["mujoco"]
    composed = replace(section.parameters, robot=replace(HUSKY, mjcf=""))
    commands = TRAJECTORIES["traj4"].commands()
    one, other = (
        MujocoPlant(c, section.drive).run(commands, State(), 0.05)
        for c in (section.parameters, composed)
    )
    assert np.array_equal(one.pose, other.pose)
    assert np.array_equal(one.channels["wheel_load_N"], other.channels["wheel_load_N"])


def check_turn(calibration: Calibration) -> None:
    """Compare a turn on the spot with mechanics, and two time steps with each other."""
    measured = [
        measures.turn(replace(calibration, timestep=dt))
        for dt in (calibration.timestep, 0.5 * calibration.timestep)
    ]
    for turned in measured:
        assert abs(turned.error) <= (
            TURN_ERROR if turned.sensitivity <= CALM else SOFTNESS + turned.sensitivity
        )
        assert turned.ripple < RIPPLE * max(1.0, turned.sensitivity)
        assert turned.load_deviation < LOAD_DEVIATION
    assert measured[1].multiplier == pytest.approx(measured[0].multiplier, rel=STEP_SPREAD)


def check_rest(calibration: Calibration) -> None:
    """Compare a robot at rest, on a slope, ahead and with blocked wheels with mechanics."""
    weight, shares = measures.resting_error(calibration)
    assert weight < WEIGHT
    assert shares < REST_LOADS
    assert abs(measures.rolling_error(calibration)) < ROLLING
    assert measures.creep(calibration) < CREEP
    if measures.tipping(calibration) < STEADY:
        for sideways in (False, True):
            assert abs(measures.stop_error(calibration, sideways)) < STOP_ERROR


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_robots_obey_mechanics(name: str) -> None:
    calibration = Calibration.of(load_robot(name))
    check_turn(calibration)
    check_rest(calibration)


@settings(DRAWN, max_examples=15)
@given(documents())
def test_a_drawn_robot_turns_as_the_closed_form_says(document: dict[str, Any]) -> None:
    check_turn(Calibration.of(parse_robot(document)))


@settings(DRAWN, max_examples=15)
@given(documents())
def test_a_drawn_robot_rests_rolls_and_stops_as_mechanics_says(document: dict[str, Any]) -> None:
    check_rest(Calibration.of(parse_robot(document)))


def test_small_wheels_get_short_steps() -> None:
    for radius, step in (
        (0.35, 0.002),
        (0.1651, 0.002),
        (0.094, 0.002),
        (0.092, 0.001),
        (0.05, 0.001),
        (0.02, 0.0005),
    ):
        geometry = {
            "wheelbase": 2.5 * radius,
            "track": 3.0 * radius,
            "wheel_radius": radius,
            "wheel_width": 0.4 * radius,
        }
        document = {
            "schema": "ssmr.robot/1",
            "name": "small",
            "geometry": geometry,
            "mass": {"total": 20.0},
        }
        assert parse_robot(document).timestep == step
        message = parse_robot({**document, "simulation": {"timestep": 0.004}})
        assert message.timestep == 0.004


# ------------------------------------------------------------------------------------------- a
# motor for each wheel
def both_links(robot: Any, **drive: float) -> tuple[MujocoPlant, MujocoPlant]:
    """The robot with belts, and with a motor for each wheel."""
    plants = []
    for link in ("belt", "none"):
        linked = replace(robot, link=link, mjcf="")
        c = Calibration.of(linked, com_x=0.0, com_y=0.0)
        base = {
            "delay_v": 0.0,
            "delay_w": 0.0,
            "v_max": 5.0,
            "w_max": 5.0,
            "command_radius": c.wheel_radius,
        }
        settled = {
            **base,
            "torque_limit": math.inf,
            "command_half_track": 1.5 * c.half_track,
            **drive,
        }
        plants.append(MujocoPlant(c, Drive(**settled)))
    return plants[0], plants[1]


@pytest.mark.parametrize("name", ["husky", "jackal"])
@pytest.mark.parametrize("integral", [False, True])
def test_four_motors_turn_a_symmetrical_robot_as_two_with_belts_do(
    name: str, integral: bool
) -> None:
    """All wheels of a side have the same load and slip on the spot.

    A belt carries nothing, and a side's torques add up.
    """
    robot = load_robot(name)
    size = robot.mass / 73.3 * robot.wheel_radius / 0.1651
    parts = (
        {"integral_gain": 800.0 * size, "dc_stiffness": 1900.0 * size, "torque_limit": 60.0 * size}
        if integral
        else {}
    )
    belts, motors = both_links(robot, **parts)
    assert (len(belts.calibration.robot.motors), len(motors.calibration.robot.motors)) == (2, 4)
    spin = Commands(0.05, np.tile([0.0, 0.6], (80, 1)))
    one, other = (plant.run(spin, State(), 0.05) for plant in (belts, motors))
    assert np.abs(one.pose - other.pose).max() < SAME
    late = one.t > 2.0
    torque = np.abs(one.channels["torque_N_m"][late]).mean()
    assert (
        np.abs(one.channels["torque_N_m"] - other.channels["torque_N_m"])[late].max()
        < SAME * torque
    )


def test_a_motor_of_its_own_slows_down_by_its_own_load() -> None:
    """With the centre of mass ahead, front wheels carry more.

    Their proportional loops yield more. A belt forbids that.
    """
    rates = []
    for link in ("belt", "none"):
        linked = replace(HUSKY, link=link, mjcf="")
        bench = measures.Bench(Calibration.of(linked, com_x=0.1))
        bench.ask(-measures.RIM_SPEED, measures.RIM_SPEED)
        bench.run(measures.TURN_TIME)
        rates.append(bench.data.qvel[bench.spins])
    (belt_front, belt_rear), (front, rear) = ((r[1], r[3]) for r in rates)
    assert belt_front == pytest.approx(belt_rear, rel=1e-3)
    assert front < 0.98 * rear


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_robot_that_is_told_to_stand_on_ten_degrees_stands(name: str) -> None:
    """It sinks into its motors' integral parts and then only creeps as its contacts do.

    A proportional loop rolls back.
    """
    plant = make_plant(bare_profile(load_robot(name)), "mujoco", Terrain(math.radians(10.0)))
    ahead = plant.run(Commands(0.1, np.zeros((60, 2))), State(), 0.1).xy[:, 0]
    assert -4e-3 < ahead[30] - ahead[0] < 0.0
    assert abs(ahead[-1] - ahead[30]) / 3.0 < 1.5e-4


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_robot_is_as_heavy_to_push_as_the_rule_of_its_rotors_says(name: str) -> None:
    robot = load_robot(name)
    mass, radius, (_, spin) = (
        robot.mass,
        robot.wheel_radius,
        robot.wheel_inertia,
    )
    measured = apparent_mass(MujocoPlant(Calibration.of(robot), robot.motor_drive).model)
    assert measured == pytest.approx(
        mass * (1.0 + 4.0 * ROTOR_SHARE) + 4.0 * spin / radius**2, rel=0.01
    )
    assert 1.45 < measured / mass < 1.55
    untold = parse_robot({**robot.as_document(), "sources": {}, "simulation": {"friction": 0.3}})
    assert untold.armature == pytest.approx(ROTOR_SHARE * mass * radius**2)
