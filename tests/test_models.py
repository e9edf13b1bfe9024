"""The planar models: each equation against its derivation, limits, energy, order of convergence."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.errors import DivergedError
from ssmr.geometry import rotate_body_to_world
from ssmr.lanes import run_population
from ssmr.models import coulomb, kinematic, linear
from ssmr.models.coulomb import CoulombParameters
from ssmr.models.improved import ImprovedParameters, _break_away, slide_step
from ssmr.models.kinematic import KinematicParameters
from ssmr.models.linear import LinearParameters
from ssmr.robot.drive import Sides
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, State
from tests.conftest import EXACT, ROUNDOFF, SYMMETRY

LOOSE = Drive(v_max=50.0, w_max=50.0, delay_v=0.0, delay_w=0.0, hold=0.05, torque_limit=math.inf)
"""A drive that does nothing but the wheel kinematics and the torque loop."""
VEHICLE = Vehicle()
SKEWED = replace(VEHICLE, a=0.3, b=0.2, x_icr=0.05)
"""A robot whose centre of gravity and of rotation lie off the middle."""
# half of a denormal number is zero
speeds = st.floats(-2.0, 2.0).map(lambda v: v if abs(v) > 1e-9 else 0.0)


def hold(v: float, w: float, seconds: float = 4.0) -> Commands:
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)), before=(v, w))


# ------------------------------------------------------------------------------- Coulomb, Eq.
# 2.14-2.28
def lagrange(
    v: float, w: float, yaw: float, torques: tuple[float, float], p: CoulombParameters, veh: Vehicle
) -> np.ndarray:
    """(2,) accelerations straight from Eq. 2.15-2.28.

    Matrices and all: S^T M S, S^T M dS/dt, S^T R, S^T E.
    """
    c = math.cos(yaw)
    s = math.sin(yaw)
    x = veh.x_icr
    s_matrix = np.array([[c, x * s], [s, -x * c], [0.0, 1.0]])  # 2.13
    s_dot = w * np.array([[-s, x * c], [c, x * s], [0.0, 0.0]])
    m = np.diag([veh.mass, veh.mass, veh.yaw_inertia])
    front = veh.a / (2 * (veh.a + veh.b)) * veh.mass * veh.gravity  # 2.17
    rear = veh.b / (2 * (veh.a + veh.b)) * veh.mass * veh.gravity
    # wheels 1 (front left), 2 (front right), 3 (rear right), 4 (rear left)
    loads = np.array([front, front, rear, rear])
    v_x = np.array(
        [
            v - veh.half_track * w,
            v + veh.half_track * w,
            v + veh.half_track * w,
            v - veh.half_track * w,
        ]
    )
    v_y = np.array([veh.b - x, veh.b - x, -veh.a - x, -veh.a - x]) * w  # 2.7
    r_x, f_y = p.u_x * loads * np.sign(v_x), p.mu_c * loads * np.sign(v_y)  # 2.18
    moment = veh.b * (f_y[0] + f_y[1]) - veh.a * (f_y[2] + f_y[3])
    moment += veh.half_track * (r_x[1] + r_x[2] - r_x[0] - r_x[3])  # 2.19
    # 2.20
    resist = np.array([r_x.sum() * c - f_y.sum() * s, r_x.sum() * s + f_y.sum() * c, moment])
    e = np.array([[c, c], [s, s], [-veh.half_track, veh.half_track]]) / veh.wheel_radius  # 2.24
    # 2.27, 2.28
    right = s_matrix.T @ (e @ np.array(torques) - resist) - s_matrix.T @ m @ s_dot @ np.array(
        [v, w]
    )
    return np.linalg.solve(s_matrix.T @ m @ s_matrix, right)


@given(
    v=speeds, w=speeds, yaw=st.floats(-3.0, 3.0), ref=st.tuples(st.floats(-9, 9), st.floats(-9, 9))
)
def test_coulomb_accelerations_follow_from_the_lagrangian(
    v: float, w: float, yaw: float, ref: tuple[float, float]
) -> None:
    p = CoulombParameters(u_x=0.07, mu_c=0.3, gain=60.0)
    robot = PlanarModel(p, SKEWED, Drive()).packed(0.001)
    resist = coulomb.resisting_loads(v, w, robot)
    dv, dw, torques = coulomb.body_accelerations(v, w, Sides(*ref), Sides(0.0, 0.0), resist, robot)
    assert np.allclose([dv, dw], lagrange(v, w, yaw, torques, p, SKEWED), rtol=1e-11, atol=1e-10)


@given(v=speeds, w=speeds)
def test_the_simplifications_of_2_2_3_are_a_case_of_coulomb(v: float, w: float) -> None:
    """With a = b and x_ICR = 0 the moment is mu m g a sgn(omega).

    R_x is u_x m g if both sides roll forward.
    """
    robot = PlanarModel(CoulombParameters(u_x=0.1, mu_c=0.2), VEHICLE, LOOSE).packed(0.001)
    force, moment = coulomb.resisting_loads(v, w, robot)
    load = VEHICLE.mass * VEHICLE.gravity
    skid = 0.2 * load * VEHICLE.a * np.sign(w)
    sides = np.sign([v - VEHICLE.half_track * w, v + VEHICLE.half_track * w])
    assert force == pytest.approx(0.1 * load * sides.mean(), abs=1e-9)
    assert moment == pytest.approx(
        skid + VEHICLE.half_track * 0.1 * load * (sides[1] - sides[0]) / 2, abs=1e-9
    )


@pytest.mark.parametrize(
    "parameters", [CoulombParameters(0.05, 0.1, 0.0), ImprovedParameters(0.05, 0.12, 0.1, 0.0)]
)
def test_undriven_energy_only_falls(parameters: CoulombParameters | ImprovedParameters) -> None:
    motion = PlanarPlant(PlanarModel(parameters, VEHICLE, LOOSE)).run(
        hold(0.0, 0.0, 2.0), State(v_x=0.8, yaw_rate=1.5), 0.001
    )
    energy = (
        0.5 * VEHICLE.mass * motion.twist[:, 0] ** 2
        + 0.5 * VEHICLE.yaw_inertia * motion.twist[:, 2] ** 2
    )
    floor = (
        0.5 * VEHICLE.mass * (0.05 * 9.81 * 0.001) ** 2
        + 0.5 * VEHICLE.yaw_inertia * (0.1 * 75.0 * 0.256 * 0.001 * 9.81 * 10) ** 2
    )
    # Coulomb's chatter at rest is at most one step's worth of friction
    assert np.all(np.diff(energy) <= floor)
    assert energy[-1] <= 2.0 * floor


def test_ccw_curve_of_a_shifted_icr_slides_outward() -> None:
    """Eq. 2.10: v_y = -x_ICR omega."""
    motion = PlanarPlant(PlanarModel(CoulombParameters(), SKEWED, LOOSE)).run(
        hold(0.3, 0.5), State(), 0.01
    )
    assert np.allclose(motion.twist[:, 1], -SKEWED.x_icr * motion.twist[:, 2], rtol=ROUNDOFF)


# ------------------------------------------------------------------------------- improved friction,
# Eq. 2.29-2.31
def breakaway_reference(parameters: ImprovedParameters) -> float:
    """Difference of wheel-rate references at which the yaw moment equals stiction [rad/s]."""
    moment = parameters.mu_s * VEHICLE.mass * VEHICLE.gravity * VEHICLE.a
    return moment * VEHICLE.wheel_radius / (VEHICLE.half_track * parameters.gain)


@pytest.mark.parametrize(
    ("share", "moves"), [(0.99, False), (1.01, True), (-0.99, False), (-1.01, True)]
)
def test_it_breaks_away_above_stiction_and_not_below(share: float, moves: bool) -> None:
    p = ImprovedParameters()
    wheel = 0.5 * share * breakaway_reference(p)
    w = wheel * VEHICLE.wheel_radius / VEHICLE.half_track
    motion = PlanarPlant(PlanarModel(p, VEHICLE, LOOSE)).run(hold(0.0, w), State(), 0.01)
    assert (abs(motion.pose[-1, 2]) > 1e-3) == moves
    if not moves:
        assert np.all(motion.twist == EXACT)  # standstill is kept, not crept


def test_stiction_does_not_make_a_moving_robot_stop_between_samples_of_one_sign() -> None:
    """Above breakaway the steady rate lacks dynamic friction over loop stiffness."""
    p = ImprovedParameters()
    motion = PlanarPlant(PlanarModel(p, VEHICLE, LOOSE)).run(hold(0.5, 0.6), State(), 0.01)
    r = VEHICLE.wheel_radius
    c = VEHICLE.half_track
    load = VEHICLE.mass * VEHICLE.gravity
    droop_v = p.u_x * load * r * r / (2.0 * p.gain)
    droop_w = p.mu_d * load * VEHICLE.a * r * r / (2.0 * p.gain * c * c)
    assert motion.twist[-1, 0] == pytest.approx(0.5 - droop_v, rel=1e-9)
    assert motion.twist[-1, 2] == pytest.approx(0.6 - droop_w, rel=1e-9)


def test_coulomb_chatters_at_rest_and_improved_does_not() -> None:
    """Fig. 3.33: the sign of friction flips at every step in one model; the other sticks."""
    still = hold(0.5, 0.0)
    chatter = PlanarPlant(PlanarModel(CoulombParameters(), VEHICLE, LOOSE)).run(
        still, State(yaw_rate=1e-4), 0.001
    )
    calm = PlanarPlant(PlanarModel(ImprovedParameters(), VEHICLE, LOOSE)).run(
        still, State(yaw_rate=1e-4), 0.001
    )
    tail = slice(1000, None)
    assert np.abs(chatter.channels["yaw_acceleration_rad_s2"][tail]).max() > 0.5
    assert np.abs(calm.channels["yaw_acceleration_rad_s2"][tail]).max() == EXACT


@given(
    v=speeds,
    active=st.floats(-300.0, 300.0),
    dynamic=st.floats(0.0, 100.0),
    more=st.floats(0.0, 50.0),
)
def test_a_step_of_a_constant_force_is_two_half_steps(
    v: float, active: float, dynamic: float, more: float
) -> None:
    """Wherever the velocity reaches zero, and whether or not friction at rest then holds it."""
    dry = (dynamic + more, dynamic)
    gain = 0.02
    once = slide_step(v, active, active, gain, *dry)
    half = slide_step(v, active, active, 0.5 * gain, *dry)
    twice = slide_step(half, active, active, 0.5 * gain, *dry)
    assert twice == pytest.approx(once, rel=SYMMETRY, abs=SYMMETRY)
    if v != 0.0 and once * v <= 0.0 and abs(active) <= dry[0]:
        assert once == EXACT


@given(start=st.floats(-1.0, 1.0), end=st.floats(-3.0, 3.0), dynamic=st.floats(0.0, 1.0))
def test_what_breaks_away_within_a_step_does_so_in_two_half_steps(
    start: float, end: float, dynamic: float
) -> None:
    """The instant at which a linear force exceeds stiction, 1, is found in either half."""
    dry = (1.0, dynamic)
    gain = 0.1
    middle = 0.5 * (start + end)
    once = _break_away(start, end, gain, *dry)
    twice = _break_away(start, middle, 0.5 * gain, *dry)
    if abs(middle) > 1.0:
        twice = slide_step(twice, middle, end, 0.5 * gain, *dry)
    else:
        twice = _break_away(middle, end, 0.5 * gain, *dry)
    assert twice == pytest.approx(once, rel=SYMMETRY, abs=SYMMETRY)
    assert (once != 0.0) == (abs(end) > 1.0)


def to_and_fro(v: float, w: float, period: float) -> Commands:
    """Commands for 12 s whose signs change twice a `period` [s]; `w` does so 1.6 times as often."""
    t = np.arange(0.0, 12.0, 0.05)
    signs = [1.0 - 2.0 * (t / half % 2.0 >= 1.0) for half in (0.5 * period, 0.3125 * period)]
    return Commands(0.05, np.column_stack([v * signs[0], w * signs[1]]))


@pytest.mark.parametrize(
    ("commands", "limit"),
    [
        (TRAJECTORIES["traj1"].commands(), 5.0),
        (TRAJECTORIES["traj3"].commands(), 5.0),
        (TRAJECTORIES["traj4"].commands(), 4.5),
        (TRAJECTORIES["traj1"].commands(), 7.0),
        (to_and_fro(0.5, 0.0, 2.0), 5.5),
        (to_and_fro(0.5, 0.0, 2.0), 7.0),
        (to_and_fro(0.5, 1.0, 2.24), 7.0),
    ],
)
def test_the_improved_step_is_of_second_order_with_motors_at_their_limit(
    commands: Commands, limit: float
) -> None:
    """A robot that breaks away, stops or turns back loses no time; a lost step each cost 4 mm."""
    model = PlanarModel(ImprovedParameters(), VEHICLE, Drive(torque_limit=limit))
    steps = (1e-3, 5e-4, 2.5e-4)
    ends = [PlanarPlant(model, dt).run(commands, State(), 0.05).pose[-1, :2] for dt in steps]
    coarse = float(np.linalg.norm(ends[0] - ends[1]))
    fine = float(np.linalg.norm(ends[1] - ends[2]))
    assert coarse < 2e-4
    assert fine < max(coarse / 3.0, 1e-5)  # what turns back is there at any step, to 0.01 mm


# ------------------------------------------------------------------------------- linear, Eq.
# 2.41-2.47
def test_linear_equals_python_control() -> None:
    """The stepped model is the zero-order-hold discretisation of its matrices."""
    p = LinearParameters()
    drive = replace(LOOSE, command_half_track=0.3, command_radius=0.17)
    rng = np.random.default_rng(3)
    commands = Commands(0.05, np.column_stack([rng.uniform(-1, 1, 60), rng.uniform(-2, 2, 60)]))
    motion = PlanarPlant(PlanarModel(p, VEHICLE, drive)).run(commands, State(), 0.001)
    system = control.sample_system(
        control.ss(*linear.state_space_matrices(VEHICLE, p, drive), np.eye(4), np.zeros((4, 2))),
        0.001,
        "zoh",
    )
    held = np.repeat(commands.values, 50, axis=0)
    response = control.forced_response(system, inputs=np.vstack([held, held[-1:]]).T)
    assert np.allclose(response.outputs[1], motion.twist[:, 0], rtol=1e-9, atol=1e-12)
    assert np.allclose(response.outputs[3], motion.twist[:, 2], rtol=1e-9, atol=1e-12)
    # theta by the trapezoidal rule on a 1 ms grid
    assert np.allclose(response.outputs[2], motion.pose[:, 2], atol=2e-3)


# ------------------------------------------------------------------------------- kinematic
@given(
    left=speeds,
    right=speeds,
    x_icr=st.floats(-0.3, 0.3),
    y_l=st.floats(0.2, 1.0),
    y_r=st.floats(-1.0, -0.2),
)
def test_each_side_has_its_centre_of_rotation(
    left: float, right: float, x_icr: float, y_l: float, y_r: float
) -> None:
    """The velocity at (x_ICR, y_l) is the left tread's: forward alpha_l left, sideways 0."""
    robot = PlanarModel(KinematicParameters(0.9, 0.8, x_icr, y_l, y_r), VEHICLE, LOOSE).packed(
        0.001
    )
    v_x, w = kinematic._body_velocity(left, right, robot)
    assert robot.x_icr == x_icr
    assert v_x - w * y_l == pytest.approx(0.9 * VEHICLE.wheel_radius * left, abs=1e-9)
    assert v_x - w * y_r == pytest.approx(0.8 * VEHICLE.wheel_radius * right, abs=1e-9)


@pytest.mark.parametrize(("left", "right"), [(3.0, 6.0), (6.0, 3.0), (-3.0, -6.0), (-4.0, 4.0)])
def test_a_bend_is_driven_with_a_drift_to_its_outside(left: float, right: float) -> None:
    """On a circle the body has the speed (v, -k v omega), away from the centre in both gears."""
    model = PlanarModel(KinematicParameters(drift=0.2), VEHICLE, LOOSE)
    n = 400
    motion = PlanarPlant(model).run(
        Commands(0.01, np.tile([left, right], (n, 1)), "wheels"), State(), 0.01
    )
    v, v_y, w = motion.twist[-1]
    assert v_y == pytest.approx(-0.2 * v * w, abs=1e-12)
    # the centripetal acceleration v omega points to the centre, the drift away from it
    assert v_y * (v * w) <= 0.0
    pose = motion.pose[2:]  # the first step begins at rest
    to_centre = rotate_body_to_world(np.array([-v_y, v]) / w, pose[:, 2])
    np.testing.assert_allclose(np.ptp(pose[:, :2] + to_centre, axis=0), 0.0, atol=1e-5)


# ------------------------------------------------------------------------------- numbers
def test_heun_is_of_second_order_where_forces_are_smooth() -> None:
    """Coulomb far from any sign change: halving the step quarters the error."""
    p = CoulombParameters(gain=5.0)
    end = []
    for dt in (0.004, 0.002, 0.001, 0.0005):
        drive = replace(LOOSE, hold=0.1)
        plant = PlanarPlant(PlanarModel(p, VEHICLE, drive), dt)
        commands = Commands(0.1, np.tile([1.0, 0.5], (10, 1)), before=(1.0, 0.5))
        end.append(plant.run(commands, State(v_x=0.5, yaw_rate=0.2), 0.1).pose[-1])
    steps = [np.linalg.norm(a - b) for a, b in itertools.pairwise(end)]
    orders = np.log2(np.array(steps[:-1]) / np.array(steps[1:]))
    assert np.all(np.abs(orders - 2.0) < 0.15), orders


def test_divergence_is_named() -> None:
    """A loop stiffer than the step can follow leaves the finite numbers, and the run says when."""
    plant = PlanarPlant(PlanarModel(CoulombParameters(gain=1e6), VEHICLE, LOOSE))
    with pytest.raises(DivergedError, match=r"coulomb: no finite velocity after step \d+"):
        plant.run(hold(0.5, 0.5), State(), 0.01)

    population = run_population(
        [PlanarModel(CoulombParameters(gain=1e6), VEHICLE, LOOSE)], hold(0.5, 0.5), [State()], 0.01
    )
    assert np.isnan(population).all()
