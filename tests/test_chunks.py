"""A long run keeps samples and forgets its steps.

The length of chunks changes nothing, and hours fit into memory.
"""

from __future__ import annotations

import numpy as np
import pytest

from ssmr.errors import DivergedError
from ssmr.robot.drive import reference_chunks, wheel_references
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, State
from validation.plants.profile import load_profile, make_plant
from validation.simulator import plant as simulator_plant
from validation.simulator.plant import MujocoPlant

SAMPLE_DT = 0.01
WHOLE = 10**9
"""Steps of a chunk that holds any run whole."""


def weave(seconds: float, kind: str = "twist") -> Commands:
    """Commands that change all the time; several turns about the vertical."""
    k = np.arange(round(20.0 * seconds))
    if kind == "wheels":
        return Commands(
            0.05, np.column_stack([2.0 + np.sin(0.1 * k), 4.0 + np.cos(0.13 * k)]), "wheels"
        )
    return Commands(
        0.05, np.column_stack([0.3 + 0.2 * np.sin(0.1 * k), 1.0 + 0.5 * np.cos(0.05 * k)])
    )


def numbers(plant: MujocoPlant, commands: Commands, push: np.ndarray | None) -> np.ndarray:
    """All numbers of a run."""
    run = plant.run(commands, State(1.0, -2.0, 9.0, 0.2), SAMPLE_DT, push)
    return np.column_stack(
        [
            run.t,
            run.pose,
            run.twist,
            run.wheels,
            *(np.atleast_2d(c.T).T for c in run.channels.values()),
        ]
    )


@pytest.mark.parametrize("size", [1, 7, 333, 4000])
@pytest.mark.parametrize("kind", ["twist", "wheels"])
def test_chunks_of_any_length_give_the_whole_run_to_the_bit(
    monkeypatch: pytest.MonkeyPatch, size: int, kind: str
) -> None:
    plant = make_plant(load_profile("husky-tile"), "mujoco")
    assert isinstance(plant, MujocoPlant)
    commands = weave(8.0 if size > 1 else 1.0, kind)
    push = np.random.default_rng(5).normal(0.0, 1.0, round(commands.duration / plant.dt))
    monkeypatch.setattr(simulator_plant, "CHUNK", WHOLE)
    whole = numbers(plant, commands, push)
    monkeypatch.setattr(simulator_plant, "CHUNK", size)
    assert np.array_equal(numbers(plant, commands, push), whole)


@pytest.mark.parametrize("kind", ["twist", "wheels"])
@pytest.mark.parametrize("size", [1, 13, 400, 10_000])
def test_references_in_chunks_are_those_of_the_whole(kind: str, size: int) -> None:
    drive = Drive(delay_v=0.2, delay_w=0.1, acceleration_v=0.7, wheel_lag=0.1, command_ramp=0.03)
    commands = weave(10.0, kind)
    state = State(wheel_left=1.0, wheel_right=2.0)
    chunks = list(reference_chunks(commands, drive, 0.002, state, size))
    assert [len(c) for c in chunks[:-1]] == [size] * (len(chunks) - 1)
    assert np.array_equal(np.concatenate(chunks), wheel_references(commands, drive, 0.002, state))


def test_a_run_that_diverges_in_a_later_chunk_says_when_and_from_what() -> None:
    plant = make_plant(load_profile("thesis-lab"), "mujoco")
    commands = weave(20.0)
    blow = 7321
    push = np.zeros(round(commands.duration / plant.dt))
    push[blow] = 1e200
    with pytest.raises(DivergedError, match="no finite state") as failed:
        plant.run(commands, State(), SAMPLE_DT, push)
    states = failed.value.evidence["states"]
    assert failed.value.evidence["t"] == pytest.approx(blow * plant.dt, abs=2.0 * plant.dt)
    assert states[-1, 0] == pytest.approx(failed.value.evidence["t"])
    assert np.isfinite(states).all()
    # nothing of that is left
    assert np.isfinite(plant.run(commands, State(), SAMPLE_DT).pose).all()
