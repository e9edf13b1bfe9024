"""Wheel loads: balances of force and moment, the static share, and the MuJoCo Husky as witness."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.parameters import pack_numbers
from ssmr.robot.ground import LoadModel
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, State
from tests.conftest import ROUNDOFF
from tests.robots import husky
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain, parse_terrain
from validation.simulator.wheel_loads import MEASURED, QUASI_STATIC, _load_model, with_quasi_static

LEVEL = np.array([[0.0, 0.0, -9.81]])
HUSKY = LoadModel(73.3, 0.0, 0.0, 0.19, 0.512, 0.5708, 0.176)
numbers = st.floats(-3, 3)
STIFF = Drive(
    delay_v=0.0,
    delay_w=0.0,
    command_half_track=0.5137,
    torque_limit=400.0,
    acceleration_v=1.0,
    wheel_lag=0.02,
)
STATIC_SHARE = 0.005
"""Of a robot at rest after a second: the contacts' last settling."""
PAIR = 0.4
WHEEL = 1.0
"""Of axles and sides, whose loads statics decides, and of single wheels, whose twist is left to the
springs [N]."""
PAIRS = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [1, 0, 1, 0], [0, 1, 0, 1]])
"""Axles and sides."""
DRIFT = 0.03
"""Of the first-order theory of a drift that is a tenth of the skid."""


def loads(
    model: LoadModel, a: tuple[float, float] = (0.0, 0.0), g: np.ndarray = LEVEL
) -> np.ndarray:
    zero = np.zeros(1)
    return model.quasi_static(np.array([a]), g, zero, zero, zero)[0]


def test_at_rest_it_is_the_static_share_of_the_thesis() -> None:
    for a, b in ((0.256, 0.256), (0.2, 0.312)):
        vehicle = Vehicle(a=a, b=b)
        static = vehicle_body(pack_numbers(vehicle))
        # front axle b ahead of the centre of gravity: that lies so far ahead of the middle
        com = 0.5 * (a + b) - b
        model = LoadModel(vehicle.mass, com, 0.0, 0.19, a + b, 0.55)
        np.testing.assert_allclose(
            loads(model), [static.load_front] * 2 + [static.load_rear] * 2, rtol=ROUNDOFF
        )


@given(numbers, numbers, st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), numbers, numbers, numbers)
def test_forces_and_moments_balance(
    ax: float, ay: float, cx: float, cy: float, spin: float, rate: float, w: float
) -> None:
    m = LoadModel(70.0, cx, cy, 0.2, 0.5, 0.6, 0.2)
    n = m.quasi_static(
        np.array([[ax, ay]]), LEVEL, np.array([spin]), np.array([rate]), np.array([w])
    )[0]
    x = 0.25 * np.array([1, 1, -1, -1])
    y = 0.3 * np.array([1, -1, 1, -1])
    assert n.sum() == pytest.approx(70.0 * 9.81)
    assert (x - cx) @ n == pytest.approx(-0.2 * 70.0 * ax - 0.2 * rate, abs=1e-9)
    assert (y - cy) @ n == pytest.approx(-0.2 * 70.0 * ay - 0.2 * spin * w, abs=1e-9)
    assert n[0] - n[1] == pytest.approx(n[2] - n[3])  # a rigid body on equal springs: no twist


@given(st.floats(0.0, 0.4), st.floats(-3, 3))
def test_a_slope_loads_as_the_acceleration_does_that_would_hide_it(
    angle: float, toward: float
) -> None:
    ramp = Terrain(angle, toward).gravity_in_body(np.zeros(1), 9.81)
    # in free slide nothing pushes along the ground
    falling = loads(HUSKY, (float(ramp[0, 0]), float(ramp[0, 1])), ramp)
    np.testing.assert_allclose(falling, 73.3 * 9.81 * math.cos(angle) / 4.0, rtol=1e-9)


@pytest.mark.parametrize("com", [(0.0, 0.0), (-0.087, 0.0), (0.05, -0.085)])
def test_the_husky_at_rest_carries_what_the_formula_says(com: tuple[float, float]) -> None:
    plant = MujocoPlant(husky(com_x=com[0], com_y=com[1]), STIFF)
    motion = plant.run(Commands(0.05, np.zeros((20, 2))), State(), 0.05)
    wanted = with_quasi_static(motion, plant, Localiser()).channels[QUASI_STATIC][-1]
    simulated = motion.channels[MEASURED][-1]
    np.testing.assert_allclose(PAIRS @ simulated, PAIRS @ wanted, rtol=STATIC_SHARE)
    # with both, the twist is left to springs, and MuJoCo's are as stiff as what they carry is heavy
    if 0.0 in com:
        np.testing.assert_allclose(simulated, wanted, rtol=STATIC_SHARE)


def test_the_huskys_load_transfer_in_speeding_up_and_in_a_steady_turn() -> None:
    plant = MujocoPlant(husky(friction=0.7, gain=2100.0, armature=1.8), STIFF)
    speeding = plant.run(Commands(0.05, np.tile([1.0, 0.0], (16, 1))), State(), 0.05)
    turning = plant.run(Commands(0.05, np.tile([1.0, 0.5], (80, 1))), State(), 0.05)
    mean = 0.25 * _load_model(plant).mass * 9.81
    for motion, window, transfer in ((speeding, slice(8, 15), 14.0), (turning, slice(50, 79), 6.0)):
        formula = (
            with_quasi_static(motion, plant, Localiser())
            .channels[QUASI_STATIC][window]
            .mean(axis=0)
        )
        simulated = motion.channels[MEASURED][window].mean(axis=0)
        assert np.abs(formula - mean).max() > transfer
        np.testing.assert_allclose(PAIRS @ simulated, PAIRS @ formula, rtol=0.0, atol=PAIR)
        np.testing.assert_allclose(simulated, formula, rtol=0.0, atol=WHEEL)


def test_where_the_motion_is_tracked_changes_no_load() -> None:
    plant = MujocoPlant(husky(friction=0.7), STIFF)
    motion = plant.run(TRAJECTORIES["traj1"].commands(), State(), 0.05)
    here = with_quasi_static(motion, plant, Localiser()).channels[QUASI_STATIC]
    localiser = Localiser(0.1, -0.05, 0.3)
    np.testing.assert_allclose(
        with_quasi_static(localiser.seen(motion), plant, localiser).channels[QUASI_STATIC],
        here,
        rtol=1e-9,
    )


def turning_drift(
    slope_angle: float, yaw_rate: float, friction: float, wheelbase: float, track: float
) -> float:
    """Mean speed [m/s] at which a robot that turns on the spot on a slope slides down it.

    A turning skid-steering robot skids on all four wheels with slip S = |omega| L D / (2 B), D^2 =
    L^2 + B^2, along and across its wheels as L : B (docs/physics.md). A further small slip d
    changes the four Coulomb forces together by -(mu m g / S) (I - s s') d, averaged over the unit
    vectors s along the slip: by -(mu m g / S) (B^2, L^2) / D^2 along and across the body. Friction,
    which holds a resting robot on any slope under mu, gives way to the least push like a fluid.
    Balance with m g sin(slope) gives v = sin(slope) S D^2 / (mu B^2) where downhill is ahead and
    sin(slope) S D^2 / (mu L^2) where it is aside; turning goes through both, and their mean is

        v = sin(slope) |omega| D^5 / (4 mu L B^3)
    """
    diagonal = math.hypot(wheelbase, track)
    return (
        math.sin(slope_angle)
        * abs(yaw_rate)
        * diagonal**5
        / (4.0 * friction * wheelbase * track**3)
    )


@pytest.mark.parametrize(
    ("friction", "degrees", "rate"), [(0.3, 1.0, 0.4), (0.6, 2.0, 0.4), (0.6, 2.0, 0.8)]
)
def test_a_robot_that_turns_on_a_slope_slides_down_it_as_derived(
    friction: float, degrees: float, rate: float
) -> None:
    terrain = parse_terrain(f"ramp:{degrees}")
    plant = MujocoPlant(husky(friction=friction, gain=2100.0, armature=1.8), STIFF, terrain=terrain)
    n = round((2.0 + 4.2 * math.pi / rate) / 0.05)
    motion = plant.run(Commands(0.05, np.tile([0.0, rate], (n, 1))), State(), 0.05)
    first = 40
    last = int(np.searchsorted(motion.yaw, motion.yaw[first] + 4.0 * math.pi))
    drift = (motion.xy[last] - motion.xy[first]) / (motion.t[last] - motion.t[first])
    turned = (motion.yaw[last] - motion.yaw[first]) / (motion.t[last] - motion.t[first])
    wanted = turning_drift(terrain.slope, turned, friction, 0.512, 0.5708)
    assert drift[0] == pytest.approx(-wanted, rel=DRIFT)
    assert abs(drift[1]) < 0.1 * wanted
    level = MujocoPlant(plant.calibration, STIFF, terrain=FLAT).run(
        Commands(0.05, np.tile([0.0, rate], (n, 1))), State(), 0.05
    )
    assert np.abs(level.xy).max() < 1e-3
