"""Noise, disturbance and sample rates: their statistics, and that a seed repeats them."""

from __future__ import annotations

import numpy as np
import pytest

from ssmr.models.improved import ImprovedParameters
from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorNoise, measure, yaw_disturbance
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.scenarios import COMMAND_PERIOD, TRAJECTORIES
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import State, Trajectory

N = 20001
STILL = Trajectory(np.arange(N) * 0.001, np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 2)))


def test_noise_has_the_published_variances() -> None:
    """1001 draws: sample variances lie within 4 standard errors, 4 sqrt(2/1000) = 18 %."""
    seen = measure(STILL, SensorNoise(), np.random.default_rng(0))
    noise = SensorNoise()
    drawn = seen.pose[::20].var(axis=0), seen.twist[::20, [0, 2]].var(axis=0)
    assert np.allclose(drawn[0], [noise.x, noise.y, noise.yaw], rtol=0.18)
    assert np.allclose(drawn[1], [noise.v_x, noise.yaw_rate], rtol=0.18)
    assert np.array_equal(seen.twist[:, 1], STILL.twist[:, 1])


@pytest.mark.parametrize("rate", [SAMPLE_RATES_HZ["ekf"], 20.0])
def test_between_samples_the_last_is_held(rate: float) -> None:
    moving = Trajectory(
        STILL.t, np.column_stack([STILL.t, 0 * STILL.t, 0 * STILL.t]), STILL.twist, STILL.wheels
    )
    quiet = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0)
    seen = measure(moving, quiet, np.random.default_rng(0), rate)
    assert np.allclose(seen.pose[:, 0], np.floor(moving.t * rate + 1e-9) / rate, atol=1e-9)


def test_a_seed_repeats_and_another_does_not() -> None:
    a, b, c = (measure(STILL, SensorNoise(), np.random.default_rng(s)).pose for s in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


def test_the_disturbance_has_its_variance_and_does_not_depend_on_the_step() -> None:
    fine = yaw_disturbance(200.0, 0.001, np.random.default_rng(3))
    coarse = yaw_disturbance(200.0, 0.002, np.random.default_rng(3))
    assert np.array_equal(fine[::2], coarse)
    assert fine[::100].var() == pytest.approx(25.0, rel=0.13)  # 2000 draws, 4 standard errors
    assert len(np.unique(fine[:1000])) == 10


def test_the_disturbance_moves_the_robot() -> None:
    plant = PlanarPlant(PlanarModel(ImprovedParameters(), Vehicle(), Drive()))
    commands = TRAJECTORIES["traj4"].commands()
    push = yaw_disturbance(commands.duration, plant.dt, np.random.default_rng(4))
    calm = plant.run(commands, State(), 0.01)
    pushed = plant.run(commands, State(), 0.01, push)
    assert np.abs(calm.yaw - pushed.yaw).max() > 1e-3
    with pytest.raises(ValueError, match="disturbances"):
        plant.run(commands, State(), 0.01, push[:-1])


@pytest.mark.parametrize(
    ("name", "frequency", "amplitude"),
    [("traj1", 0.5, 1.0), ("traj2", 0.25, 0.25), ("traj3", 0.25, 0.5), ("traj4", 0.25, 0.75)],
)
def test_trajectories_are_table_3_6(name: str, frequency: float, amplitude: float) -> None:
    scenario = TRAJECTORIES[name]
    values = scenario.commands().values
    t = np.arange(scenario.commands().n) * COMMAND_PERIOD
    late = t >= scenario.lead_in
    assert np.all(values[:, 0] == 0.5)
    assert np.all(values[~late, 1] == 0.0)
    assert np.allclose(
        values[late, 1], amplitude * np.sin(2 * np.pi * frequency * (t[late] - scenario.lead_in))
    )
    assert scenario.commands().duration == scenario.duration
