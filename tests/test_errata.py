"""Each contradiction of the thesis that can be shown, shown (docs/errata.md has the list)."""

from __future__ import annotations

import ast
import itertools
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssmr.control.law import Observation
from ssmr.control.laws import design_controller
from ssmr.control.loop import LoopSettings
from ssmr.control.population import run_loops
from ssmr.control.references import line
from ssmr.control.waypoints import Target, position_errors
from ssmr.estimation.ekf import run_ekf
from ssmr.estimation.settings import EkfSettings
from ssmr.metrics.declared import compare_paths
from ssmr.metrics.paths import path_length
from ssmr.models import linear
from ssmr.models.coulomb import CoulombParameters
from ssmr.models.improved import ImprovedParameters
from ssmr.models.linear import LOAD_SUM, LinearParameters
from ssmr.robot.sensors import SensorNoise, simulate_sensors
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT, PlanarModel, PlanarPlant
from ssmr.types import Commands, State, Trajectory
from tests.test_docs import tables
from validation.output import ignore_progress
from validation.replicate.chapters import Task
from validation.replicate.control import track_tables
from validation.replicate.lab import variance_above, with_late_samples
from validation.replicate.published import printed_table, printed_value

AGREEMENT = 0.03
"""The published models lie within 0.0145 to 0.0150 m (d_rms, trajectory 4) of the same robot, so
within twice that of each other [m]."""

PUBLISHED: dict[str, object] = {
    "coulomb": CoulombParameters(),
    "improved": ImprovedParameters(),
    "linear": LinearParameters(),
}


def lab_run(
    parameters: object, scenario: str = "traj4", drive: Drive | None = None, duration: float = 20.0
) -> Trajectory:
    commands = replace(TRAJECTORIES[scenario], duration=duration).commands()
    return PlanarPlant(PlanarModel(parameters, Vehicle(), drive or Drive())).run(
        commands, State(), SAMPLE_DT
    )


def distance(one: Trajectory, other: Trajectory) -> float:
    """d_rms from the shorter path to the longer [m], as the thesis measured.

    Its robot drove less far than its models.
    """
    short, long = sorted((one, other), key=lambda m: path_length(m.xy))
    return compare_paths(long, short)["d_rms_m"]


def test_defaults_are_the_published_parameters() -> None:
    for number, parameters, names in (
        ("3.8", CoulombParameters(), {"u_x": "u_x", "mu_c": "mu_c", "gain": "K_P_tau"}),
        (
            "3.11",
            ImprovedParameters(),
            {"u_x": "u_x", "mu_s": "mu_s", "mu_d": "mu_d", "gain": "K_P_tau"},
        ),
        ("3.14", LinearParameters(), {"k_u": "K_u", "k_y": "K_y", "gain": "K_P_tau"}),
    ):
        for ours, theirs in names.items():
            assert getattr(parameters, ours) == printed_value(number, theirs), (number, ours)
        assert Drive().delay_v == printed_value(number, "delay_u_s")
        assert Drive().delay_w == printed_value(number, "delay_w_s")
        assert Drive().torque_limit == printed_value(number, "tau_max_wheel_N_m")


def test_scenarios_and_noise_are_the_published_ones() -> None:
    for name, scenario in TRAJECTORIES.items():
        row = printed_table("3.6")["rows"][name]
        assert (scenario.speed, scenario.frequency, scenario.amplitude) == (
            row["u_cmd_m_s"],
            row["frequency_hz"],
            row["amplitude_rad_s"],
        )
    noise = SensorNoise()
    for ours, theirs in {
        "v_x": "dx",
        "yaw_rate": "dtheta",
        "x": "X",
        "y": "Y",
        "yaw": "theta",
    }.items():
        assert getattr(noise, ours) == printed_value("3.4", theirs)


@pytest.mark.parametrize(("one", "other"), list(itertools.combinations(PUBLISHED, 2)))
def test_the_published_models_agree_on_trajectory_4(one: str, other: str) -> None:
    """As their published distances from the real robot demand."""
    assert distance(lab_run(PUBLISHED[one]), lab_run(PUBLISHED[other])) <= AGREEMENT


def test_1_the_torque_limit_is_per_wheel() -> None:
    """With 7 N m a side the improved model's rolling resistance exceeds the thrust.

    The robot never starts.
    """
    p = ImprovedParameters()
    vehicle = Vehicle()
    assert p.u_x * vehicle.mass * vehicle.gravity > 2 * 7.0 / vehicle.wheel_radius
    stuck = lab_run(p, drive=Drive(torque_limit=3.5))
    assert np.abs(stuck.pose).max() == 0.0
    assert path_length(lab_run(p).xy) > 9.0


def test_3_the_linear_gain_belongs_to_speeds_in_metres() -> None:
    """Eq. 2.44 lacks 1/r.

    Divided by r, the published gain is of the size of the nonlinear ones' only as N m s/m.
    """
    p = LinearParameters()
    # [N m s/rad], beside 56.75 and 118.04
    assert p.gain * Vehicle().wheel_radius == pytest.approx(37.9, abs=0.1)
    _, b = linear.state_space_matrices(Vehicle(), p, Drive())
    assert b[1, 0] == pytest.approx(2 * p.gain / (Vehicle().wheel_radius * Vehicle().mass))


def test_4_printed_a22_loses_a_third_of_the_speed() -> None:
    a, b = linear.state_space_matrices(Vehicle(), LinearParameters(), Drive())
    printed = -(a[1, 1] + b[1, 0]) / LOAD_SUM * Vehicle().mass
    assert b[1, 0] / (b[1, 0] + printed) == pytest.approx(0.656, abs=0.001)


def test_4b_the_linear_friction_carries_four_loads() -> None:
    """The published length ratios and the agreement ask for it.

    With g K_u the linear model disagrees with both others; with 4 g K_u it agrees, with Coulomb
    within 5 mm, and its path is as long as theirs, as the published length ratios (0.9974 of
    Coulomb's on every trajectory) demand.
    """
    coulomb, improved, four = (lab_run(p) for p in PUBLISHED.values())
    one_load = lab_run(replace(PUBLISHED["linear"], k_u=LinearParameters().k_u / LOAD_SUM))
    assert distance(coulomb, four) < 0.005
    assert distance(improved, four) < AGREEMENT
    assert distance(coulomb, one_load) > AGREEMENT
    assert distance(improved, one_load) > AGREEMENT
    ratios = [
        printed_value("3.15", f"traj{i}", "d_ratio") / printed_value("3.9", f"traj{i}", "d_ratio")
        for i in (1, 2, 3, 4)
    ]
    assert np.allclose(ratios, 0.9974, atol=1.5e-4)
    ours = path_length(four.xy) / path_length(coulomb.xy)
    assert (
        abs(ours - 0.9974)
        < 0.003
        < 0.01
        < path_length(one_load.xy) / path_length(coulomb.xy) - 0.9974
    )


def test_4c_without_torque_limit_the_linear_model_runs_ahead() -> None:
    """Tab. 3.14 lists the limit; without it the start is too quick and the agreement is lost."""
    free = lab_run(LinearParameters(), drive=Drive(torque_limit=math.inf))
    assert distance(lab_run(ImprovedParameters()), free) > AGREEMENT


def test_5_the_published_k_y_belongs_to_the_printed_lever() -> None:
    """With the moment's own lever a^2 in place of c the yaw gain becomes 0.993.

    As printed it is 0.973, close to Coulomb's.
    """
    vehicle = Vehicle()
    p = LinearParameters()
    a, b = linear.state_space_matrices(vehicle, p, Drive())
    printed = -b[3, 1] / a[3, 3]
    loop = b[3, 1]
    physical = loop / (
        loop + vehicle.mass * vehicle.gravity * p.k_y * vehicle.a**2 / vehicle.yaw_inertia
    )
    coulomb = lab_run(CoulombParameters()).twist[:, 2].max() / 0.75
    assert printed == pytest.approx(0.973, abs=0.001)
    assert physical == pytest.approx(0.993, abs=0.001)
    assert abs(printed - coulomb) < abs(physical - coulomb)


def test_6_the_second_c_of_the_yaw_equation_is_a_misprint() -> None:
    """(c/r)(tau_R - tau_L) c has the unit N m2.

    The published steady yaw gain needs one c (with two it would be 0.907).
    """
    a, b = linear.state_space_matrices(Vehicle(), LinearParameters(), Drive())
    friction = -a[3, 3] - b[3, 1]
    assert b[3, 1] / (b[3, 1] + friction) > 0.97
    assert 0.275 * b[3, 1] / (0.275 * b[3, 1] + friction) == pytest.approx(0.908, abs=0.002)


def test_8_printed_dynamic_friction_would_push_a_reversing_robot() -> None:
    """-FDJ without the sign of v does positive work.

    At v < 0 its power is positive. With it (docs) a robot slows down from either side.
    """
    coast = Commands(0.05, np.zeros((20, 2)))
    for v in (0.4, -0.4):
        drive = Drive(delay_v=0.0, delay_w=0.0)
        plant = PlanarPlant(PlanarModel(replace(ImprovedParameters(), gain=0.0), Vehicle(), drive))
        assert abs(plant.run(coast, State(v_x=v), 0.01).twist[-1, 0]) < 0.4


def test_9_the_printed_cost_rewards_a_robot_that_stays_at_the_start() -> None:
    """Eq. 3.1 adds K d_ratio: shrinking the path pays; |1 - d_ratio| does not let it."""
    reference = lab_run(ImprovedParameters())
    half = Trajectory(
        reference.t, reference.pose * [0.97, 0.97, 1.0], reference.twist, reference.wheels
    )
    shrunk = compare_paths(half, reference)
    same = compare_paths(reference, reference)
    assert 5.0 * shrunk["d_ratio"] < 5.0 * same["d_ratio"]
    assert 5.0 * abs(1.0 - shrunk["d_ratio"]) > 5.0 * abs(1.0 - same["d_ratio"])


def test_15_the_lengths_of_coulomb_and_improved_runs_date_the_recording() -> None:
    """They fit a whole run from rest.

    The published length ratios of both models differ by a factor of 1.0002 to 1.0003 on
    trajectories 1 to 3. Runs of 20 to 25 s from rest give 0.9998 to 1.0007 on trajectories 2 to 4
    (0.9986 to 0.9994 on 1), shorter and longer ones do not, so the lab compared whole runs. On
    trajectory 4 the published factor is 1.0088: a misprint.
    """
    published = [
        printed_value("3.12", f"traj{i}", "d_ratio") / printed_value("3.9", f"traj{i}", "d_ratio")
        for i in (1, 2, 3)
    ]
    assert np.allclose(published, 1.00025, atol=1.5e-4)
    assert (
        printed_value("3.12", "traj4", "d_ratio") / printed_value("3.9", "traj4", "d_ratio") > 1.008
    )
    for scenario in ("traj2", "traj3", "traj4"):
        improved, coulomb = (
            [
                path_length(lab_run(PUBLISHED[name], scenario, duration=d).xy)
                for d in (12.0, 20.0, 25.0, 40.0)
            ]
            for name in ("improved", "coulomb")
        )
        short, twenty, twenty_five, long = np.divide(improved, coulomb)
        assert short < 0.998
        assert 0.9997 < twenty < 1.00025 < twenty_five < 1.0008
        assert long > 1.001


def test_16_table_3_6_amplitude_is_a_yaw_rate() -> None:
    """As an amplitude in metres 0.75 m would be a path as wide as it is long.

    As rad/s the turns fit a room.
    """
    assert TRAJECTORIES["traj4"].commands().values[:, 1].max() == pytest.approx(0.75, rel=1e-2)
    assert np.ptp(lab_run(ImprovedParameters()).yaw) < math.pi / 2


def test_42_the_printed_distance_drives_a_robot_on_that_has_overtaken() -> None:
    """A target at rest a tenth of a metre behind, u = K_P e for 2 s.

    As printed the robot leaves, else it comes back.
    """
    gain = printed_value("4.4", "K_P_rho")
    dt = 0.01
    origin = Target(0.0, 0.0, 0.0, 0.0, 0.0, 0)
    ahead = {"printed": 0.1, "used": 0.1}  # how far the robot is ahead of its target
    for _ in range(200):
        for form in ahead:
            e_rho, _, _ = position_errors(Observation(ahead[form], 0.0, 0.0, 0.0, 0.0), origin, 0.4)
            ahead[form] += dt * gain * (abs(e_rho) if form == "printed" else e_rho)
    assert ahead["printed"] > 10.0
    assert abs(ahead["used"]) < 1e-3


def test_43_the_gaps_of_the_line_are_not_those_of_the_manual_weights() -> None:
    """The steady distance is at least v / K_11, and e^(-K_I T) of it is left at the end."""
    for number, row, speed in (("4.22", "line_0.25", 0.25), ("4.23", "line_0.50", 0.5)):
        left = math.exp(-printed_value("4.21", "K_I_rho", "manual") * 10.8 / speed)
        gaps = {
            column: speed
            / math.sqrt(
                printed_value("4.21", "Q_11", column) / printed_value("4.21", "R_11", column)
            )
            * left
            for column in ("manual", "optimised")
        }
        printed = printed_value(number, row, "d_haus_m")
        assert gaps["manual"] > 1.6 * printed
        assert gaps["optimised"] == pytest.approx(printed, rel=0.1)


def test_43b_nor_are_the_circles_but_one_pair_of_gains_makes_both() -> None:
    """The printed lengths and gaps at 0.25 m/s, with weights as printed and as supposed."""
    tables = track_tables(("4.22", "4.24"), Task(0, 1, ignore_progress, draws=2))
    for number in tables:
        ((_, pairs),) = tables[number].items()
        printed, manual, supposed = (
            {m: getattr(pair, name) for m, pair in pairs.items()}
            for name in ("published", "ours", "supposed")
        )
        assert manual["d_haus_m"] > 1.8 * printed["d_haus_m"]
        assert abs(manual["d_ratio"] - printed["d_ratio"]) > 0.005
        assert supposed["d_haus_m"].ours == pytest.approx(printed["d_haus_m"], rel=0.2)
        assert abs(supposed["d_ratio"].ours - printed["d_ratio"]) < 0.005
    assert supposed["d_rms_m"].ours == pytest.approx(printed["d_rms_m"], rel=0.1)


def test_44_the_high_pass_filter_takes_noise_away_too() -> None:
    """White noise of the printed variance leaves less than that behind the printed filter."""
    printed = printed_value("3.4", "dx")
    for rate, share in ((50.0, 0.623), (120.0, 0.843)):
        noise = np.random.default_rng(44).normal(0.0, math.sqrt(printed), 100_000)
        assert variance_above(noise, rate) == pytest.approx(share * printed, rel=0.02)


def test_45_wrong_stamps_make_x_noisy_and_nothing_else() -> None:
    """A filter's output in a straight run at 0.5 m/s, and with stamps wrong by 10 ms."""
    t = np.arange(0.0, 40.0, 0.02)
    straight = np.column_stack([0.5 * t, 0.0 * t, 0.0 * t])
    motion = Trajectory(
        t, straight, np.tile([0.5, 0.0, 0.0], (len(t), 1)), np.full((len(t), 2), 0.5 / 0.1651)
    )
    log = simulate_sensors(motion, np.random.default_rng(1), rate=50.0)
    seen = run_ekf(log, EkfSettings(), State(v_x=0.5))
    off = with_late_samples(motion, seen, 0.010, np.random.default_rng(2))
    (x, y, dx), (x_off, y_off, dx_off) = (
        [variance_above(values, 50.0) for values in (m.pose[:, 0], m.pose[:, 1], m.twist[:, 0])]
        for m in (seen, off)
    )
    assert x < printed_value("3.4", "X") / 1e3
    assert y < printed_value("3.4", "Y")
    # at the faster of the speeds of Tab. 3.3
    assert printed_value("3.4", "X") < x_off < 2.5 * printed_value("3.4", "X")
    assert (y_off, dx_off) == pytest.approx((y, dx), rel=0.05)


def test_46_three_bounds_of_the_search_let_unstable_gains_in() -> None:
    """On a line, errors die out a little below the bounds of the errata.

    They do not above them, nor at the printed ends.
    """
    bounds = {
        "k_p_rho": (5.17, "K_P_rho", "v_cmd"),
        "k_p_u": (0.914, "K_P_u", "v_cmd"),
        "k_p_w": (1.010, "K_P_omega", "w_cmd"),
    }
    robot = PlanarModel(LinearParameters(), Vehicle(), Drive())
    seen = LoopSettings("truth", disturbance=False)
    model = linear.state_space_matrices(robot.vehicle, LinearParameters(), robot.drive)
    start = State(y=1e-3, v_x=0.5, wheel_left=0.5 / 0.1651, wheel_right=0.5 / 0.1651)
    for name, (bound, row, column) in bounds.items():
        gains = printed_table("4.4")["rows"][row]
        values = (gains["optimised"], 0.95 * bound, 1.05 * bound, gains["search"][1])
        laws = [design_controller("pid", {name: value}, *model) for value in values]
        runs = run_loops([robot] * 4, laws, [seen] * 4, line(0.5, 20.0), [0], start)
        # of the last command the target stands
        thirds = [np.array_split(run.column(column)[:-1], 3) for run in runs]
        assert [np.ptp(late) < 0.5 * np.ptp(middle) for _, middle, late in thirds[1:]] == [
            True,
            False,
            False,
        ], name
        assert np.ptp(thirds[0][2]) < 2e-3


def test_every_erratum_is_numbered_and_shown_by_a_test_that_exists_or_by_the_text() -> None:
    existing = set()
    for name in ("test_errata.py", "test_published.py"):
        tree = ast.parse(Path(__file__).with_name(name).read_text(encoding="utf-8"))
        existing |= {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    numbers = []
    for rows in tables("errata.md").values():
        for row in (r for r in rows if r[0].isdigit()):
            numbers.append(int(row[0]))
            claimed = re.findall(r"`(test_\w+)`", row[-1])
            assert (row[-1] == "text") != bool(claimed), row[0]
            assert set(claimed) <= existing, (row[0], set(claimed) - existing)
    assert numbers == list(range(1, len(numbers) + 1))
