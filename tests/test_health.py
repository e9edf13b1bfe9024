"""A run's health: inertia, torque and trembling, against a law or the simulator."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import FloatArray, State, Trajectory
from tests.robots import husky
from validation.compare import compare
from validation.plants.profile import Profile
from validation.simulator.calibration import Calibration
from validation.simulator.health import (
    START_TIME,
    Health,
    apparent_mass,
    health_verdict,
    loads_tremble,
    run_health,
)
from validation.simulator.model import GRAVITY, _resting_depth, robot_model
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant

WHEEL_INERTIA = 0.04411  # husky.xml [kg m2]
PUSHED = 1e-3
"""Relative, of the apparent mass against its closed form: tyres creep a little, and roll at the
radius to 0.1 %."""
DRIVE = Drive(
    delay_v=0.2,
    delay_w=0.2,
    command_half_track=0.5188,
    acceleration_v=1.16,
    wheel_lag=0.02,
    torque_limit=400.0,
)
JERKY = husky(friction=0.7, gain=2800.0, armature=1.8, wheel_radius=0.16)


# ------------------------------------------------------------------------------- inertia
@pytest.mark.parametrize(
    "calibration",
    [
        husky(armature=0.1),
        husky(armature=1.8, gain=2100.0, friction=0.7, rolling_resistance=0.13, wheel_radius=0.15),
        husky(armature=0.3, wheel_shape="cylinder"),
        husky(armature=0.3, radius_difference=0.01),
        husky(
            armature=0.2,
            wheel_shape="capsule",
            friction_ratio=1.2,
            com_x=-0.08,
            mass=110.0,
            yaw_inertia=6.0,
        ),
        husky(armature=0.05, timestep=0.005),
    ],
)
def test_a_push_feels_the_mass_and_what_turns_with_the_wheels(calibration: Calibration) -> None:
    plant = MujocoPlant(calibration, DRIVE)
    before = mujoco.MjModel.__copy__(plant.model)
    spin = 2.0 * (WHEEL_INERTIA + calibration.armature)
    half = 0.5 * calibration.radius_difference
    radii = calibration.wheel_radius + half, calibration.wheel_radius - half
    wanted = calibration.mass + sum(spin / radius**2 for radius in radii)
    assert apparent_mass(plant.model) == pytest.approx(wanted, rel=PUSHED)
    for name in ("tendon_frictionloss", "dof_damping", "dof_frictionloss"):
        assert np.array_equal(getattr(plant.model, name), getattr(before, name))
    assert plant.model.opt.disableflags == before.opt.disableflags


@pytest.mark.parametrize("solref", [(0.02, 1.0), (0.006, 1.0)])
@pytest.mark.parametrize(
    "solimp",
    [(0.1, 0.95, 0.005, 0.5, 2.0), (0.3, 0.9, 0.004, 0.4, 3.0), (0.9, 0.95, 0.001, 0.5, 2.0)],
)
def test_a_resting_tyre_is_as_deep_as_the_law_of_soft_contact_says(
    solref: tuple[float, float], solimp: tuple[float, float, float, float, float]
) -> None:
    model = robot_model(
        husky(), settings=PhysicsSettings(solver="Newton", solref=solref, solimp=solimp)
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    contact = data.contact[0]
    give = float(data.efc_force[contact.efc_address] * data.efc_diagA[contact.efc_address])
    assert _resting_depth(give, solref, solimp) == pytest.approx(-contact.dist, rel=1e-6)


# ------------------------------------------------------------------------------- trembling
def driven(calibration: Calibration, drive: Drive, scenario: str) -> Health:
    plant = MujocoPlant(calibration, drive)
    return run_health(
        plant.model, [plant.run(TRAJECTORIES[scenario].commands(), State(), calibration.timestep)]
    )


@pytest.mark.parametrize("scenario", ["traj1", "traj4"])
def test_whoever_follows_the_advice_on_trembling_calms_the_loads(scenario: str) -> None:
    """Each of the four pieces of advice alone, in the simulator."""
    health = driven(JERKY, DRIVE, scenario)
    assert loads_tremble(health)
    assert health["ok"]
    advised = {
        "command_ramp": (JERKY, replace(DRIVE, command_ramp=DRIVE.hold)),
        "lag": (JERKY, replace(DRIVE, wheel_lag=5.0 * DRIVE.wheel_lag)),
        "gain": (replace(JERKY, gain=0.2 * JERKY.gain), DRIVE),
        "armature": (replace(JERKY, armature=5.0 * JERKY.armature), DRIVE),
    }
    for word, (calibration, drive) in advised.items():
        assert word in health["advice"]
        calmer = driven(calibration, drive, scenario)["load_sum_rms_N"]
        assert calmer is not None
        assert calmer < 0.6 * health["load_sum_rms_N"], word


# ------------------------------------------------------------------------------- the verdict
def loads_of(total: FloatArray) -> Trajectory:
    m = len(total)
    channels = {
        "wheel_load_N": np.tile(0.25 * total[:, None], (1, 4)),
        "torque_N_m": np.tile([3.0, -7.5], (m, 1)),
    }
    return Trajectory(
        0.01 * np.arange(m), np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 2)), channels
    )


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return MujocoPlant(husky(), DRIVE).model


def test_the_sum_is_judged_after_the_start_and_over_all_pieces(model: mujoco.MjModel) -> None:
    weight = float(model.body_subtreemass[1]) * GRAVITY
    total = np.full(1001, weight)
    total[: round(100 * START_TIME)] += 100.0
    calm = run_health(model, [loads_of(total)])
    assert calm["load_sum_rms_N"] == pytest.approx(0.0, abs=1e-9)
    assert not loads_tremble(calm)
    assert calm["advice"] == ""
    assert health_verdict(calm) == "healthy"
    assert calm["peak_torque_N_m"] == 7.5
    total[-100:] += 30.0
    shaken = run_health(model, [loads_of(total), loads_of(np.full(1001, weight))])
    judged = 2 * (1001 - round(100 * START_TIME))
    assert shaken["load_sum_rms_N"] == pytest.approx(30.0 * math.sqrt(100 / judged), rel=1e-9)
    short = np.full(101, weight)
    short[:50] += 100.0
    assert run_health(model, [loads_of(short)])["load_sum_rms_N"] == pytest.approx(0.0, abs=1e-9)


def test_a_limit_that_is_passed_is_named_in_the_advice(model: mujoco.MjModel) -> None:
    weight = float(model.body_subtreemass[1]) * GRAVITY
    shaken = run_health(model, [loads_of(weight * (1.0 + 0.02 * (-1.0) ** np.arange(1000)))])
    assert shaken["ok"]
    assert loads_tremble(shaken)
    assert health_verdict(shaken) == "loads tremble"
    assert "tremble" in shaken["advice"]
    given = run_health(
        model, [loads_of(weight * (1.0 + 0.02 * (-1.0) ** np.arange(1000)))], given_rates=True
    )
    assert "peak_torque_N_m" not in given
    assert "smooth the given wheel rates" in given["advice"]
    assert "gain" not in given["advice"]


# ------------------------------------------------------------------------------- in a comparison
def test_compare_tells_inertia_torque_and_trembling(lab: Profile) -> None:
    comparison = compare("traj4", lab, ("mujoco", "improved"), noise=True)
    health = comparison.as_dict()["plants"]["mujoco"]["health"]
    section = lab.plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    motion = plant.run(TRAJECTORIES["traj4"].commands(), State(), 0.008)
    assert health["peak_torque_N_m"] == pytest.approx(
        np.abs(motion.channels["torque_N_m"]).max(), rel=0.05
    )
    spin = 4.0 * (WHEEL_INERTIA + section.parameters.armature) / section.parameters.wheel_radius**2
    assert health["apparent_mass_kg"] == pytest.approx(section.parameters.mass + spin, rel=PUSHED)
    after = motion.t >= START_TIME
    total = motion.channels["wheel_load_N"][after].sum(axis=1)
    assert health["load_sum_rms_N"] == pytest.approx(
        np.sqrt(np.mean((total - health["weight_N"]) ** 2)), rel=0.05
    )
    assert "health" not in comparison.as_dict()["plants"]["improved"]
    text = comparison.table()
    assert f"{health['apparent_mass_kg']:.1f}" in text
    assert f"{health['peak_torque_N_m']:.1f}" in text
    assert f"{health['load_sum_rms_N']:.1f}" in text
    assert "Health" in text


def test_compare_says_how_far_weak_motors_make_the_end_uncertain(lab: Profile) -> None:
    """Half the step moves the end by as much as is said; shipped motors are not at their limit."""
    shipped = lab.plants["mujoco"]
    weak = replace(shipped, drive=replace(shipped.drive, torque_limit=8.0))
    profile = replace(lab, plants={**lab.plants, "mujoco": weak})
    comparison = compare("traj1", profile, ("mujoco", "kinematic"))
    health = comparison.as_dict()["plants"]["mujoco"]["health"]
    ends = []
    for dt in (weak.parameters.timestep, 0.5 * weak.parameters.timestep):
        plant = MujocoPlant(replace(weak.parameters, timestep=dt), weak.drive)
        start = weak.localiser.body_state(State())
        motion = plant.run(TRAJECTORIES["traj1"].commands(), start, 0.008)
        ends.append(weak.localiser.seen(motion, None).pose[-1, :2])
    moved = 1e3 * math.dist(*ends)
    assert health["at_limit"] in health["advice"]
    assert "limit of 16 N m a side for 18.2 s" in health["at_limit"]
    assert f"the end of its path is uncertain by some {moved:.1f} mm" in health["at_limit"]
    assert "mujoco: motors were at their limit" in comparison.table()
    assert health["ok"]
    strong = compare("traj1", lab, ("mujoco", "kinematic")).as_dict()
    assert "at_limit" not in strong["plants"]["mujoco"]["health"]
