"""Robots side by side in lanes.

Each moves as it does alone, to the bit, and the loop over them is vector instructions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr import lanes
from ssmr._jit import jit, sine_cosine
from ssmr.lanes import LANES, run_population
from ssmr.models.law import PLANAR_MODELS, Advanced, PlanarLaw, PlanarRobot, planar_law
from ssmr.parameters import describe_parameters, parameter
from ssmr.robot.drive import Sides, side_rates
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import SAMPLE_DT, PlanarModel, PlanarPlant
from ssmr.types import Commands, FloatArray, State
from tests.conftest import EXACT

SINE = 2.3e-16
"""Error of a sine or cosine in itself [1]: a rounding of a number near 1."""


@dataclass(frozen=True)
class DragParameters:
    """The one number of a law that no vector instruction can follow: it calls `math.tanh`."""

    drag: float = parameter(30.0, unit="N", low=0.0, search=(0.0, 100.0))


@jit
def drag(
    v: float, w: float, wheels: Sides, integral: Sides, disturbance: float, robot: PlanarRobot
) -> Advanced:
    actual = side_rates(v, w, robot.vehicle)
    left = 20.0 * (wheels.left - actual.left)
    right = 20.0 * (wheels.right - actual.right)
    resisting = robot.parameters.drag * math.tanh(50.0 * v)
    turning = robot.vehicle.half_track * (right - left) / robot.vehicle.wheel_radius
    thrust = (left + right) / robot.vehicle.wheel_radius - resisting
    v_next = v + robot.dt * thrust / robot.vehicle.mass
    return v_next, w + robot.dt * turning / robot.vehicle.yaw_inertia, Sides(left, right)


PlanarLaw("drag", DragParameters, drag)
KINDS = {**{name: planar_law(name).parameters for name in PLANAR_MODELS}, "drag": DragParameters}
WIND_UP = {"integral_gain": 300.0, "gear_loss": 2.0, "no_load_rate": 12.0}
DRIVES = {
    "plain": {},
    "special": {**WIND_UP, "wheel_lag": 0.1, "command_ramp": 0.03},
    "quick": {"hold": 0.003},
}


def candidates(kind: type, count: int, special: dict[str, float]) -> list[PlanarModel]:
    """Return robots with different numbers: delays, limits, half-tracks, masses, the law's."""
    rng = np.random.default_rng(3)
    rows = []
    for _ in range(count):
        own = {
            n: (getattr(kind(), n) or 0.05) * rng.uniform(0.9, 1.1)
            for n in describe_parameters(kind)
        }
        vehicle = Vehicle(
            mass=rng.uniform(60, 90),
            effective_half_track=rng.uniform(0.3, 0.5),
            x_icr=rng.uniform(-0.1, 0.1),
        )
        drive = Drive(
            delay_v=rng.uniform(0.0, 0.3),
            delay_w=rng.uniform(0.0, 0.3),
            acceleration_v=rng.uniform(0.5, 5.0),
            command_half_track=rng.uniform(0.25, 0.4),
            torque_limit=rng.uniform(3.0, 8.0),
            **special,
        )
        rows.append(
            PlanarModel(
                kind(**own), replace(vehicle, radius_difference=rng.uniform(-0.01, 0.01)), drive
            )
        )
    return rows


def inputs(kind: str = "twist") -> Commands:
    """Return commands that start, stop, reverse and turn on the spot.

    Stiction, breakaway and limits all happen.
    """
    rng = np.random.default_rng(4)
    values = rng.uniform(-1.0, 1.0, (60, 2)) * ([1.2, 2.4] if kind == "twist" else [6.0, 6.0])
    values[rng.uniform(size=60) < 0.3] = 0.0
    return Commands(0.05, np.repeat(values, 2, axis=0), kind)  # type: ignore[arg-type]


def alone(models: list[PlanarModel], commands: Commands, starts: list[State]) -> FloatArray:
    measured = [
        PlanarPlant(m).run(commands, s, SAMPLE_DT) for m, s in zip(models, starts, strict=True)
    ]
    return np.array([motion.pose for motion in measured])


@pytest.mark.parametrize(
    ("name", "special"),
    [
        # what a special drive adds to the loop knows nothing of the law
        pytest.param(name, special, marks=[pytest.mark.slow] * (k > 0 and special == "special"))
        for k, name in enumerate(KINDS)
        for special in DRIVES
    ],
)
def test_a_robot_in_a_lane_moves_as_it_does_alone(name: str, special: str) -> None:
    """Each robot has its own delay, ramp, half-track and law.

    Neighbours, order and number of robots change no bit.
    """
    models = candidates(KINDS[name], 2 * LANES + 1, DRIVES[special])
    starts = [State(0.1 * i, -0.2, 0.3 * i, 0.05, 0.0, 0.02 * i) for i in range(len(models))]
    together = run_population(models, inputs(), starts, SAMPLE_DT)
    assert np.abs(together - alone(models, inputs(), starts)).max() == EXACT
    assert np.ptp(together[:, -1, 0]) > 0.1  # they do move apart
    order = np.random.default_rng(5).permutation(len(models))[: LANES + 3]
    others = run_population(
        [models[i] for i in order], inputs(), [starts[i] for i in order], SAMPLE_DT
    )
    assert np.abs(others - together[order]).max() == EXACT
    assert (
        np.abs(run_population(models[4:5], inputs(), starts[4:5], SAMPLE_DT) - together[4]).max()
        == EXACT
    )


@pytest.mark.parametrize("name", PLANAR_MODELS)
def test_given_wheel_rates_drive_every_lane(name: str) -> None:
    models = candidates(KINDS[name], LANES + 2, {})
    commands = inputs("wheels")
    starts = [State(yaw=0.1 * i) for i in range(len(models))]
    assert (
        np.abs(
            run_population(models, commands, starts, SAMPLE_DT) - alone(models, commands, starts)
        ).max()
        == EXACT
    )


def test_a_lane_that_diverges_leaves_its_neighbours_alone() -> None:
    kind = KINDS["coulomb"]
    models = candidates(kind, 4, {})
    stiff = replace(models[1].parameters, gain=1e6)
    free = replace(models[1].drive, torque_limit=math.inf)
    wild = PlanarModel(stiff, models[1].vehicle, free)
    poses = run_population([models[0], wild, *models[2:]], inputs(), [State()] * 4, SAMPLE_DT)
    assert np.isnan(poses[1]).all()
    tame = [models[0], *models[2:]]
    assert np.abs(poses[[0, 2, 3]] - alone(tame, inputs(), [State()] * 3)).max() == EXACT


def test_the_loop_over_the_lanes_is_vector_instructions() -> None:
    """The law with the most branches.

    Only the halves of the step, which all lanes share, are products of single numbers.
    """
    robot = candidates(KINDS["improved"], 1, {})[0].packed(0.001)
    loop = numba.njit(nogil=True, error_model="numpy")(lanes._run_lanes.py_func)
    places = np.zeros(2 * LANES, dtype=np.uint64)
    rows = np.ones((3 + 100) * LANES)
    loop(
        robot,
        True,
        None,
        np.zeros(100),
        places,
        rows,
        (8, 8),
        np.empty((1, 2, 3)),
    )
    (code,) = loop.inspect_llvm().values()
    products = [line for line in code.splitlines() if " fmul " in line]
    assert len(products) > 30
    single = [line for line in products if " x double>" not in line]
    assert all("5.000000e-01" in line for line in single), single


@given(st.floats(-1e6, 1e6))
def test_sine_and_cosine_are_those_of_the_angle(angle: float) -> None:
    """Less than one rounding of the angle away, and each within a rounding."""
    sine, cosine = sine_cosine(angle)
    slack = SINE + math.ulp(angle)
    assert abs(sine - math.sin(angle)) <= slack
    assert abs(cosine - math.cos(angle)) <= slack
