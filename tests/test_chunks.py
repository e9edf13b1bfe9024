"""A long run keeps samples and forgets its steps.

The length of chunks changes nothing, and hours fit into memory.
"""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from ssmr.errors import DivergedError
from ssmr.robot.drive import reference_chunks, wheel_references
from ssmr.robot.localiser import Localiser
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, State
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Piece
from validation.files.csv_logs import write_csv
from validation.files.inspection import open_log
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


@pytest.mark.parametrize("name", ["mujoco", "improved", "kinematic"])
@pytest.mark.parametrize("late", [(0.0, 0.0), (0.31, -0.07), (-2.0, 2.0)])
def test_a_motion_is_seen_in_parts_as_in_whole(
    monkeypatch: pytest.MonkeyPatch, name: str, late: tuple[float, float]
) -> None:
    plant = make_plant(load_profile("husky-tile"), name)
    commands = weave(20.0)
    localiser = Localiser(0.2, -0.1, 0.4, *late)
    t = 7.0 + np.cumsum(np.random.default_rng(3).uniform(0.01, 0.09, 380))
    piece = Piece(commands, State(1.0, 2.0, 3.0), t, None)
    start = localiser.body_state(piece.start)
    whole = localiser.seen(plant.run(commands, start, SAMPLE_DT), t)
    monkeypatch.setattr(simulator_plant, "CHUNK", 333)
    monkeypatch.setattr("ssmr.simulation._AT_ONCE", 777)
    parts = drive_piece(plant, piece, localiser, SAMPLE_DT)
    for field in ("t", "pose", "twist", "wheels"):
        assert np.array_equal(getattr(parts, field), getattr(whole, field)), field
    assert parts.channels.keys() == whole.channels.keys()
    for channel, values in whole.channels.items():
        assert np.array_equal(parts.channels[channel], values), channel


def test_hours_of_a_log_take_no_more_than_a_few_times_what_is_kept() -> None:
    """The run has five samples for each of the log's."""
    plant = make_plant(load_profile("husky-tile"), "kinematic")
    commands = Commands(SAMPLE_DT, np.tile([0.3, 0.2], (2_000_000, 1)), "wheels")
    t = 0.05 * np.arange(400_001)
    piece = Piece(commands, State(), t, None)
    drive_piece(plant, Piece(weave(1.0, "wheels"), State(), t[:20], None), Localiser(), SAMPLE_DT)
    tracemalloc.start()
    motion = drive_piece(plant, piece, Localiser(), SAMPLE_DT)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    signals = (motion.t, motion.pose, motion.twist, motion.wheels, *motion.channels.values())
    assert peak < 4.0 * sum(signal.nbytes for signal in signals)


LONG_COMPARE = """
import resource, sys
from validation.compare import compare
for path in sys.argv[1:]:
    compare(path, plants=("kinematic",), input="wheels")
    print(1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is counted in kB on Linux alone")
def test_a_log_of_hours_is_compared_in_less_than_ten_times_its_numbers(tmp_path: Path) -> None:
    """A log is driven again and again, and the first time brings the imports."""
    log = open_log("husky").log.on_one_clock()
    length = float(log.t[-1] - log.t[0]) + 0.05
    paths = []
    for name, times in (("once", 1), ("hours", 300_000 // len(log.t))):
        columns = {column: np.tile(values, times) for column, values in log.columns.items()}
        begins = length * np.arange(times)
        columns["t"] = np.add.outer(begins, log.t).ravel()
        paths.append(tmp_path / f"{name}.csv")
        write_csv(columns, paths[-1])
    size = sum(values.nbytes for values in columns.values())
    command = [sys.executable, "-c", LONG_COMPARE, *map(str, paths)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    before, after = map(int, printed.split())
    assert after - before < 10.0 * size


def test_signals_that_were_let_go_are_made_again() -> None:
    inspected = open_log("sample")
    ways = inspected.ways
    inspected.forget_signals()
    assert inspected.ways is not ways
    for name, way in inspected.ways.items():
        assert np.array_equal(way, ways[name]), name
