"""The main program as its user runs it: files, exit status, messages.

And what a comparison must be.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.metrics.declared import Metrics
from ssmr.robot.localiser import Localiser
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, Plant, State, Trajectory
from tests.conftest import exit_status
from validation import cli
from validation.compare import compare
from validation.experiment.runs import drive_all, drive_piece
from validation.experiment.scores import score_windows
from validation.experiment.sources import open_source
from validation.files.csv_logs import write_csv
from validation.plants.profile import Profile, load_profile, make_plant


def recorded(profile: Profile, plant: str, tmp_path: Path, *, gap: bool = False) -> Path:
    """A recording of a plant that weaves for 16 s, as CSV.

    With a gap of 1 s in the middle if asked for.
    """
    t = np.arange(320) * 0.05
    # it stands at first: what was commanded before a log begins nobody knows
    driving = (t >= 1.0)[:, None]
    commands = Commands(0.05, np.column_stack([0.3 + 0.1 * np.sin(t), np.sin(0.7 * t)]) * driving)
    motion = make_plant(profile, plant).run(commands, State(), 0.05)
    pose = profile.plants[plant].localiser.seen_pose(motion.pose)
    held = np.vstack([commands.values, commands.values[-1:]])
    columns = {
        "t": motion.t,
        "cmd_v": held[:, 0],
        "cmd_w": held[:, 1],
        "gyro_z": motion.twist[:, 2],
    }
    columns |= {"enc_left": motion.wheels[:, 0], "enc_right": motion.wheels[:, 1]}
    columns |= dict(zip(("x", "y", "yaw"), pose.T, strict=True))
    keep = (motion.t < 8.0) | (motion.t > 9.0) if gap else np.full(len(motion), fill_value=True)
    path = tmp_path / "drive.csv"
    write_csv({name: values[keep] for name, values in columns.items()}, path)
    return path


# ------------------------------------------------------------------------------- as a library


@pytest.mark.parametrize("plant", ["improved", "mujoco", "kinematic"])
def test_a_plant_is_found_again_in_its_own_recording(
    lab: Profile, plant: str, tmp_path: Path
) -> None:
    """Through CSV and back: what is left is the estimated speed of the start, and interpolation."""
    source = open_source(str(recorded(lab, plant, tmp_path)))
    comparison = compare(source, lab, (plant,), horizons=(2.0, 6.0))
    assert comparison.scores[plant].metrics["sync_rms_m"] < 0.01
    assert comparison.scores[plant].horizons[6.0].position_median_m < 0.01
    assert comparison.scores[plant].horizons[2.0].n == 8


def test_gaps_are_not_bridged(lab: Profile, tmp_path: Path) -> None:
    source = open_source(str(recorded(lab, "improved", tmp_path, gap=True)))
    assert len(source.pieces) == 2
    comparison = compare(source, lab, ("improved",), horizons=(2.0, 6.0, 7.5, 60.0))
    windows = comparison.scores["improved"].horizons
    assert windows[2.0].n == 3 + 3
    assert windows[6.0].n == 2
    assert 60.0 not in windows
    for piece in comparison.runs["improved"].motions:
        assert np.diff(piece.t).max() < 0.06


def test_windows_are_scored_at_the_tracked_point(lab: Profile, tmp_path: Path) -> None:
    """A plant whose tracked point is set where the recording's was fits.

    One whose is not errs by what the point swings.
    """
    text = (
        'schema = "ssmr.profile/1"\n'
        "[plants.kinematic.localiser]\n"
        "tracked_x = 0.3\n"
        "tracked_y = 0.1\n"
    )
    (tmp_path / "p.toml").write_text(text)
    shifted = load_profile(str(tmp_path / "p.toml"))
    source = open_source(str(recorded(lab, "kinematic", tmp_path)))
    there = drive_piece(
        make_plant(shifted, "kinematic"), source.pieces[0], Localiser(0.3, 0.1), source.sample_dt
    )
    reference = source.pieces[0].reference
    assert np.allclose(there.pose[0], reference.pose[0])  # type: ignore[union-attr]
    errors = score_windows(Metrics(), source.pieces, [there], (2.0,)).horizons
    error = errors[2.0].position_median_m
    assert 0.02 < error < 0.4


def test_the_document_says_how_it_was_made_and_how_long_it_took(lab: Profile) -> None:
    """Its other keys are those of the golden files."""
    document = compare("traj3", lab, ("improved",)).as_dict()
    assert document["schema"] == "ssmr.compare/1"
    assert {"source", "profile", "reference", "seed", "versions", "plants"} <= set(document)
    assert {"wall_s", "real_time_factor"} <= set(document["plants"]["improved"])


# ------------------------------------------------------------------------------- as a program


@pytest.mark.parametrize("scenario", sorted(TRAJECTORIES))
def test_distances_that_a_profile_tells_are_those_of_the_robot(lab: Profile, scenario: str) -> None:
    compared = compare(
        scenario, lab, plants=("mujoco", "improved", "kinematic"), reference="improved"
    )
    measured = compared.scores["mujoco"].metrics
    told = lab.provenance["mujoco"]
    tenth_mm = 1e-4
    assert measured["d_rms_m"] == pytest.approx(told["d_rms_m"][scenario], abs=tenth_mm)
    assert measured["sync_rms_m"] == pytest.approx(told["sync_rms_m"][scenario], abs=tenth_mm)
    caption = compared.tables()[0].caption
    assert "All paths are those of the robot's middle." in caption
    assert "mujoco was fitted to traj4@improved" in caption
    assert "torque rms does not compare mujoco with improved" in caption


def test_torques_of_bodies_and_those_of_planar_models_compare_among_themselves(
    lab: Profile,
) -> None:
    for pair in (("mujoco", "four_wheel"), ("improved", "linear", "kinematic")):
        compared = compare("traj4", lab, plants=pair, reference=pair[0])
        assert "torque" not in compared.tables()[0].caption


def test_a_recording_of_ones_own_from_another_folder(
    lab: Profile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(lab, "improved", tmp_path)
    monkeypatch.chdir(tmp_path)
    words = "drive.csv --plants improved,kinematic --profile thesis-lab --horizons 2,6 --no-rerun"
    assert exit_status(compare.command, *words.split()) == 0
    document: dict[str, Any] = json.loads(
        (tmp_path / "runs/compare/drive/compare.json").read_text()
    )
    assert document["reference"] == "recording"
    assert set(document["plants"]["improved"]["horizons"]) == {"2", "6"}
    assert not (tmp_path / "runs/compare/drive/compare.rrd").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="interrupts are sent otherwise there")
def test_an_interrupt_in_mid_run_leaves_nothing(
    lab: Profile,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorded(lab, "improved", tmp_path)
    monkeypatch.chdir(tmp_path)
    program = sys.modules["validation.experiment.runs"]
    real = program.drive_piece
    monkeypatch.setattr(
        program, "drive_piece", lambda *a: (os.kill(os.getpid(), signal.SIGINT), real(*a))[1]
    )
    assert exit_status(compare.command, "drive.csv", "--out", "out") == cli.EXIT_INTERRUPTED
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted"
    assert not (tmp_path / "out").exists()


def test_a_program_replaces_its_own_files_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = shlex.split("traj2 --plants linear --reference linear --no-rerun")
    assert [exit_status(compare.command, *words, "--out", "named") for _ in range(2)] == [0, 0]
    # which says whose the picture is
    for name, status in (("compare.png", 0), ("compare.json", 2)):
        (tmp_path / "named" / name).write_text("of somebody else")
        assert exit_status(compare.command, *words, "--out", "named") == status
    assert exit_status(compare.command, *words, "--out", "named", "--overwrite") == 0


class Waiting:
    """A plant that waits for others, as one does on a busy machine."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    def run(self, *its: Any, **named: Any) -> Trajectory:
        """Return the motion, half a second later."""
        time.sleep(0.5)
        return self._plant.run(*its, **named)


def test_real_time_counts_the_processor_and_not_the_wait() -> None:
    source = open_source("traj4")
    profile = load_profile("thesis-lab")
    plant = make_plant(profile, "kinematic")
    plant.run(source.pieces[0].commands, State(), source.sample_dt)  # compiled
    plants: dict[str, Any] = {"waiting": Waiting(plant)}
    run = drive_all(source, plants, {"waiting": Localiser()})["waiting"]
    simulated = source.pieces[0].commands.duration
    assert run.wall_s >= 0.5
    assert run.real_time_factor > 3.0 * simulated / run.wall_s
