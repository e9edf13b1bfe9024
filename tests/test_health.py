"""What a run's health says: inertia, torque, trembling and slip, each held against a law or against the simulator."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, State, Trajectory
from tests.conftest import ROUNDOFF
from tests.robots import husky
from validation.compare import compare
from validation.plants.profile import Profile
from validation.simulator.calibration import Calibration
from validation.simulator.contact_law import ContactLaw, contact_law
from validation.simulator.description import WHEELS
from validation.simulator.health import (
    PUSH_SHARE,
    START_TIME,
    Examined,
    Health,
    check_health,
    examine,
    run_health,
)
from validation.simulator.model import GRAVITY, robot_model, wheel_geoms
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant

WHEEL_INERTIA = 0.04411  # husky.xml [kg m2]
PUSHED = 1e-3
"""Relative, of the apparent mass against its closed form: tyres creep a little, and roll at the radius to 0.1 %."""
RISE = 5e-3
"""Relative, of the body's rise over slip speed, which the measured slip speed limits."""
DRIVE = Drive(delay_v=0.2, delay_w=0.2, command_half_track=0.5188, acceleration_v=1.16, wheel_lag=0.02, torque_limit=400.0)
JERKY = husky(friction=0.7, gain=2100.0, armature=1.8, wheel_radius=0.16)


# ------------------------------------------------------------------------------- inertia
@pytest.mark.parametrize(
    "calibration",
    [
        husky(armature=0.1),
        husky(armature=1.8, gain=2100.0, friction=0.7, rolling_resistance=0.13, wheel_radius=0.15),
        husky(armature=0.3, wheel_shape="cylinder"),
        husky(armature=0.3, radius_difference=0.01),
        husky(armature=0.2, wheel_shape="capsule", friction_ratio=1.2, com_x=-0.08, mass=110.0, yaw_inertia=6.0),
        husky(armature=0.05, timestep=0.005),
    ],
)
def test_a_push_feels_the_mass_and_what_turns_with_the_wheels(calibration: Calibration) -> None:
    plant = MujocoPlant(calibration, DRIVE)
    before = mujoco.MjModel.__copy__(plant.model)
    spin, half = 2.0 * (WHEEL_INERTIA + calibration.armature), 0.5 * calibration.radius_difference
    radii = calibration.wheel_radius + half, calibration.wheel_radius - half
    wanted = calibration.mass + sum(spin / radius**2 for radius in radii)
    found = examine(plant.model, calibration)
    assert found.apparent_mass == pytest.approx(wanted, rel=PUSHED)
    assert found.weight == pytest.approx(calibration.mass * GRAVITY, rel=ROUNDOFF)
    for name in ("tendon_frictionloss", "dof_damping", "dof_frictionloss"):
        assert np.array_equal(getattr(plant.model, name), getattr(before, name))
    assert plant.model.opt.disableflags == before.opt.disableflags


def test_the_push_is_weak_against_what_makes_a_tyre_slide() -> None:
    assert 0.25 * 0.1 > PUSH_SHARE / 2  # a tenth of friction, a fourth of which would do


# ------------------------------------------------------------------------------- slip and ride height
@cache
def at_rest(
    calibration: Calibration, settings: PhysicsSettings, slip_damping: float | None
) -> tuple[mujoco.MjModel, mujoco.MjData, ContactLaw]:
    exact = replace(settings, solver="Newton")  # the law is held against physics, not against a solver's tolerance
    model = MujocoPlant(calibration, replace(DRIVE, torque_limit=math.inf), settings=exact).model
    if slip_damping is not None:
        model.pair_solreffriction[:] = 0.0, -slip_damping
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    return model, data, contact_law(model, data, wheel_geoms(model))


def spinning(calibration: Calibration, slip: float, model: mujoco.MjModel, rest: mujoco.MjData) -> tuple[float, float]:
    """Slip speed of the tyres [m/s] and rise of the body [m] while the robot turns on the spot at about the speed `slip`."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = rest.qpos, rest.qvel
    ratio = calibration.friction_ratio
    along = 0.2854 * (ratio * 0.512 / 0.5708) ** 2  # slip of a tyre over the yaw rate, by the closed form of turning
    rate = slip * max(ratio, 1.0) / math.hypot(along, ratio * 0.256)
    wheel = rate * (0.2854 + along) / calibration.wheel_radius
    data.ctrl[:] = -wheel, wheel
    mujoco.mj_step(model, data, nstep=round(2.0 / model.opt.timestep))
    w, left = data.qvel[5], data.qvel[6]
    radius = model.geom_size[wheel_geoms(model)[0], 0] + 0.5 * data.contact[0].dist  # to the middle of the overlap
    found = math.hypot(-0.2854 * w - radius * left, ratio * 0.256 * w) / max(ratio, 1.0)
    return found, float(data.qpos[2] - rest.qpos[2])


@pytest.mark.parametrize(
    ("calibration", "settings", "slip_damping"),
    [
        (husky(friction=0.3, gain=2000.0), SHIPPED, None),
        (husky(friction=0.7, gain=2000.0), SHIPPED, None),
        (husky(friction=0.5, gain=2000.0, wheel_shape="capsule"), SHIPPED, None),
        (husky(friction=0.5, gain=2000.0, wheel_shape="capsule", friction_ratio=0.6), SHIPPED, None),
        (husky(friction=0.5, gain=2000.0, wheel_shape="capsule", friction_ratio=1.24), SHIPPED, None),
        (husky(friction=0.5, gain=2000.0), PhysicsSettings(impratio=1.0), None),
        (husky(friction=0.5, gain=2000.0), PhysicsSettings(solref=(0.006, 1.0)), None),
        (husky(friction=0.5, gain=2000.0), PhysicsSettings(solref=(0.006, 1.0)), 105.0),
        (husky(friction=0.5, gain=2000.0), PhysicsSettings(solimp=(0.3, 0.9, 0.004, 0.4, 3.0)), None),
    ],
)
def test_the_body_rides_as_high_as_the_law_says(
    calibration: Calibration, settings: PhysicsSettings, slip_damping: float | None
) -> None:
    model, rest, law = at_rest(calibration, settings, slip_damping)
    assert law.depth(0.0) == pytest.approx(-rest.contact[0].dist, rel=1e-6)
    slips, rises = np.transpose(
        [spinning(calibration, share * law.slip_limit, model, rest) for share in (0.02, 0.1, 0.4, 0.7, 0.9)]
    )
    assert slips[0] < 0.03 * law.slip_limit
    assert slips[-1] > 0.85 * law.slip_limit
    assert rises == pytest.approx([law.rise(slip) for slip in slips], rel=RISE)
    assert law.depth(law.slip_limit * 1.001) == pytest.approx(0.0, abs=1e-9)
    assert law.rise(law.slip_limit) == pytest.approx(law.depth(0.0), rel=1e-3)


def test_the_slip_limit_is_the_closed_form_of_the_documentation() -> None:
    """Friction times slip speed is below N A T d_max (1 - d0) / (2 d0): 0.72 m/s as shipped (docs/physics.md)."""
    for friction in (0.3, 0.6, 1.0):
        law = at_rest(husky(friction=friction), SHIPPED, None)[2]
        formula = 0.5 * law.load * law.inverse_mass * law.time_constant * 0.95 * (1.0 - 0.1) / 0.1
        assert friction * law.slip_limit == pytest.approx(formula * (1.0 + friction**2 / 100.0), rel=1e-6)
        assert formula == pytest.approx(0.721, abs=0.002)
        assert law.time_constant == pytest.approx(0.02, rel=1e-4)


def test_ground_without_tyres_and_pyramids_have_no_law() -> None:
    model = robot_model(husky(), settings=PhysicsSettings(cone="pyramidal"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=100)
    with pytest.raises(ValueError, match="pyramidal"):
        contact_law(model, data, wheel_geoms(model))
    model = robot_model(husky())
    data = mujoco.MjData(model)
    data.qpos[2] = 1.0
    mujoco.mj_step(model, data)
    with pytest.raises(ValueError, match="touches"):
        contact_law(model, data, wheel_geoms(model))


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0, 0.0, 0.0), (0.4, 0.1, 0.7, 1.0, 5.0), (-0.2, 0.05, -0.4, 2.0, -1.0)])
def test_slip_is_the_speed_of_the_rubber_over_the_ground(place: tuple[float, ...]) -> None:
    """Held against the simulator's own velocity of the point where a tyre touches the ground."""
    v_x, v_y, rate, left, right = place
    calibration = husky(radius_difference=0.008)
    plant = MujocoPlant(calibration, DRIVE)
    examined = examine(plant.model, calibration)
    motion = Trajectory(
        np.zeros(1), np.zeros((1, 3)), np.array([[v_x, v_y, rate]]), np.array([[left, right]]), {}
    )  # fmt: skip
    data = mujoco.MjData(plant.model)
    data.qvel[:2], data.qvel[5] = (v_x, v_y), rate
    data.qvel[6:10] = [right if wheel.endswith("right") else left for wheel in WHEELS]
    mujoco.mj_forward(plant.model, data)
    for wheel, slip in zip(WHEELS, examined.slip_speeds(motion)[0], strict=True):
        body = plant.model.body(wheel).id
        radius = examined.radii[int(wheel.endswith("right"))]
        jacobian = np.zeros((3, plant.model.nv))
        mujoco.mj_jac(plant.model, data, jacobian, None, data.xpos[body] - [0.0, 0.0, radius], body)
        assert slip == pytest.approx(np.hypot(*(jacobian @ data.qvel)[:2]), abs=1e-9)


# ------------------------------------------------------------------------------- trembling
def driven(calibration: Calibration, drive: Drive, scenario: str) -> tuple[Examined, Health]:
    plant = MujocoPlant(calibration, drive)
    motion = plant.run(TRAJECTORIES[scenario].commands(), State(), calibration.timestep)
    examined = examine(plant.model, calibration)
    return examined, run_health(examined, [motion])


@pytest.mark.parametrize("scenario", ["traj1", "traj4"])
def test_whoever_follows_the_advice_on_trembling_calms_the_loads(scenario: str) -> None:
    """Each of the four pieces of advice alone, in the simulator."""
    _, health = driven(JERKY, DRIVE, scenario)
    assert health.trembles
    assert health.ok
    assert health.load_sum_rms_N is not None
    advised = {
        "command_ramp": (JERKY, replace(DRIVE, command_ramp=DRIVE.hold)),
        "lag": (JERKY, replace(DRIVE, wheel_lag=5.0 * DRIVE.wheel_lag)),
        "gain": (replace(JERKY, gain=0.2 * JERKY.gain), DRIVE),
        "armature": (replace(JERKY, armature=5.0 * JERKY.armature), DRIVE),
    }
    for word, (calibration, drive) in advised.items():
        assert word in health.advice
        calmer = driven(calibration, drive, scenario)[1].load_sum_rms_N
        assert calmer is not None
        assert calmer < 0.6 * health.load_sum_rms_N, word


# ------------------------------------------------------------------------------- the verdict
def loads_of(total: FloatArray) -> Trajectory:
    m = len(total)
    channels = {"wheel_load_N": np.tile(0.25 * total[:, None], (1, 4)), "torque_N_m": np.tile([3.0, -7.5], (m, 1))}
    return Trajectory(0.01 * np.arange(m), np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 2)), channels)


@cache
def examined_husky() -> Examined:
    calibration = husky()
    return examine(MujocoPlant(calibration, DRIVE).model, calibration)


def test_the_sum_is_judged_after_the_start_and_over_all_pieces() -> None:
    husky = examined_husky()
    total = np.full(1001, husky.weight)
    total[: round(100 * START_TIME)] += 100.0
    calm = run_health(husky, [loads_of(total)])
    assert calm.load_sum_rms_N == pytest.approx(0.0, abs=1e-9)
    assert not calm.trembles
    assert calm.advice == ""
    assert calm.verdict == "healthy"
    assert calm.peak_torque_N_m == 7.5
    total[-100:] += 30.0
    shaken = run_health(husky, [loads_of(total), loads_of(np.full(1001, husky.weight))])
    judged = 2 * (1001 - round(100 * START_TIME))
    assert shaken.load_sum_rms_N == pytest.approx(30.0 * math.sqrt(100 / judged), rel=1e-9)
    short = np.full(101, husky.weight)
    short[:50] += 100.0
    assert run_health(husky, [loads_of(short)]).load_sum_rms_N == pytest.approx(0.0, abs=1e-9)


def test_a_limit_that_is_passed_is_named_in_the_advice() -> None:
    husky = examined_husky()
    shaken = run_health(husky, [loads_of(husky.weight * (1.0 + 0.02 * (-1.0) ** np.arange(1000)))])
    assert shaken.ok
    assert shaken.trembles
    assert shaken.verdict == "loads tremble"
    assert "tremble" in shaken.advice
    given = run_health(husky, [loads_of(husky.weight * (1.0 + 0.02 * (-1.0) ** np.arange(1000)))], given_rates=True)
    assert given.peak_torque_N_m is None
    assert "smooth the given wheel rates" in given.advice
    assert "gain" not in given.advice
    fast = replace(
        loads_of(np.full(1000, husky.weight)), wheels=np.full((1000, 2), 1.01 * husky.contact.slip_limit / 0.1651)
    )
    spun = run_health(husky, [fast])
    assert spun.slips_too_fast
    assert spun.verdict == "slips too fast"
    assert f"{husky.contact.slip_limit:.2f} m/s" in spun.advice
    slow = replace(fast, wheels=0.98 * fast.wheels)
    assert run_health(husky, [slow]).advice == ""


def test_a_gate_of_loads_alone_says_nothing_of_what_it_does_not_know() -> None:
    health = check_health(np.full((100, 4), 180.0))
    assert health.advice == ""
    assert set(health.as_dict()) == {"lowest_load_share", "load_deviation", "ok", "advice"}


# ------------------------------------------------------------------------------- in a comparison
def test_compare_tells_inertia_torque_and_trembling(lab: Profile) -> None:
    found = compare("traj4", lab, ("mujoco", "improved"), noise=True)
    health = found.as_dict()["plants"]["mujoco"]["health"]
    section = lab.plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    motion = plant.run(TRAJECTORIES["traj4"].commands(), State(), 0.008)
    assert health["peak_torque_N_m"] == pytest.approx(np.abs(motion.channels["torque_N_m"]).max(), rel=0.05)
    spin = 4.0 * (WHEEL_INERTIA + section.parameters.armature) / section.parameters.wheel_radius**2
    assert health["apparent_mass_kg"] == pytest.approx(section.parameters.mass + spin, rel=PUSHED)
    after = motion.t >= START_TIME
    total = motion.channels["wheel_load_N"][after].sum(axis=1)
    assert health["load_sum_rms_N"] == pytest.approx(np.sqrt(np.mean((total - health["weight_N"]) ** 2)), rel=0.05)
    assert "health" not in found.as_dict()["plants"]["improved"]
    text = found.table()
    assert f"{health['apparent_mass_kg']:.1f}" in text
    assert f"{health['peak_torque_N_m']:.1f}" in text
    assert f"{health['load_sum_rms_N']:.1f}" in text
    assert "Health" in text
    notes = [note.get_text() for ax in found.figure().axes for note in ax.texts]
    assert any(f"{health['apparent_mass_kg']:.0f} kg to push" in note for note in notes)


def test_given_wheel_rates_have_no_torque_of_the_robots_own(lab: Profile) -> None:
    section = lab.plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    rates = np.tile([3.0, 3.0], (100, 1))
    motion = plant.run(Commands(0.05, rates, kind="wheels"), State(wheel_left=3.0, wheel_right=3.0, v_x=0.48), 0.01)
    health = run_health(examine(plant.model, section.parameters), [motion], given_rates=True)
    assert "peak_torque_N_m" not in health.as_dict()
    assert health.apparent_mass_kg is not None
