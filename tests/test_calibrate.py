"""Calibration.

Known numbers come back in every file, what is no better is not kept, and faulty logs are refused.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.types import FloatArray
from tests.conftest import exit_status, keep_one_start
from tests.test_objective import recorded
from validation.calibrate import calibrate
from validation.descriptions.loading import load_robot
from validation.files.csv_logs import write_csv
from validation.files.formats import log_path
from validation.files.inspection import open_log
from validation.fit import fit
from validation.plants.profile import Profile, load_profile
from validation.plants.searchable import make_space, with_values
from validation.refitting import settings_to_go_on

TRUTH = {"alpha_l": 0.95, "alpha_r": 0.91, "y_l": 0.45, "y_r": -0.52, "drift": 0.12}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a Husky whose numbers are known.

    Its poses follow from its wheels, for it has no localiser's noise: `--trust` takes them.
    """
    lab = load_profile("thesis-lab")
    true = with_values("kinematic", lab.plants["kinematic"], list(TRUTH), TRUTH.values())
    path = tmp_path_factory.mktemp("log") / "drive.csv"
    write_csv(
        recorded(Profile("true", "", {**lab.plants, "kinematic": true}, {}), "kinematic", 40.0),
        path,
    )
    return path


def without_commands(log: Path) -> dict[str, FloatArray]:
    """Return columns of a log by name, but not the commands: their driver takes many fits."""
    table = np.genfromtxt(log, delimiter=",", names=True)
    names = [name for name in table.dtype.names or () if not name.startswith("cmd")]
    return {name: np.array(table[name]) for name in names}


def write_rows(path: Path, columns: dict[str, FloatArray]) -> Path:
    """Write columns as a log."""
    header = ",".join(columns)
    np.savetxt(path, np.array(list(columns.values())).T, "%.17g", ",", header=header, comments="")
    return path


def calibrated(log: Path, out: Path, *arguments: str) -> dict[str, Any]:
    assert (
        exit_status(calibrate, str(log), "--plants", "kinematic", "--out", str(out), *arguments)
        == 0
    )
    return dict(json.loads((out / "calibrate.json").read_text()))


def test_a_driver_of_one_plant_begins_within_the_bounds_of_another(log: Path) -> None:
    """A limit that the log never reaches may end anywhere, here beyond what MuJoCo's may be."""
    driver = fit(
        "kinematic",
        log,
        profile="thesis-lab",
        input="commands",
        free=("acceleration_v", "delay"),
        bounds={"acceleration_v": (50.0, 60.0)},
        search="lsq",
    )
    begun = settings_to_go_on(driver, "mujoco", {})["guess"]
    most = make_space("mujoco", ["acceleration_v"], {}, driver.base.robot).upper[0]
    assert begun["acceleration_v"] == most < 50.0
    assert begun["delay"] == pytest.approx(driver.parameters[1].value)
    # bounds of a number that is held stand for nothing, and keep no fit from going on
    bounds = {"delay": (0.0, 0.5), "command_half_track": (0.1, 0.9)}
    rest = settings_to_go_on(driver, "mujoco", bounds, without="acceleration_v")
    assert rest["free"] == ("delay",)
    assert rest["bounds"] == {"delay": (0.0, 0.5)}


@pytest.fixture(scope="module")
def true(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a calibration by that log."""
    folder = tmp_path_factory.mktemp("true")
    with pytest.MonkeyPatch.context() as patch:
        keep_one_start(patch)
        calibrated(log, folder, "--robot", "husky", "--profile", "thesis-lab", "--trust")
    return folder


def test_known_numbers_come_back_in_every_file(true: Path) -> None:
    document = json.loads((true / "calibrate.json").read_text())["plants"]["kinematic"]
    assert document["better"]
    for name, value in TRUTH.items():
        assert document["parameters"][name]["value"] == pytest.approx(value, abs=0.02), name
    before = document["before"]["6"]
    after = document["after"]["6"]
    assert after["position_median_m"] < 0.2 * before["position_median_m"]
    assert after["position_low_m"] <= after["position_median_m"] <= after["position_high_m"]
    profile = load_profile(true / "profile.toml").plants["kinematic"]
    assert profile.parameters.drift == document["parameters"]["drift"]["value"]
    # a delay and a lag of the wheels act alike but in the first moment of a change
    assert profile.drive.delay_v + profile.drive.wheel_lag == pytest.approx(
        load_profile("thesis-lab").plants["kinematic"].drive.delay_v, abs=0.02
    )
    lines = (true / "diff_drive.yaml").read_text().splitlines()
    split = (line.partition(": ") for line in lines)
    reported = {name.strip(): value.partition("  #")[0] for name, _, value in split}
    said = [line.split()[0] for line in lines if "  # standard error " in line]
    assert said == [
        "wheel_separation_multiplier:",
        "left_wheel_radius_multiplier:",
        "right_wheel_radius_multiplier:",
    ]
    track = float(reported["wheel_separation"]) * float(reported["wheel_separation_multiplier"])
    assert (float(reported["wheel_separation"]), track) == pytest.approx(
        (load_robot("husky").track, 0.97), abs=0.02
    )
    for side in ("l", "r"):
        told_ratio = float(
            reported[f"{'left' if side == 'l' else 'right'}_wheel_radius_multiplier"]
        )
        assert told_ratio == pytest.approx(TRUTH[f"alpha_{side}"], abs=0.02)
    assert (true / "calibrate.md").is_file()
    page = (true / "calibrate.html").read_text()
    headings = re.findall(r"<h\d>(.*?)</h\d>", page)
    assert headings[1:4] == [
        "Paths of unseen data",
        "Error of the relative pose on unseen data, and how sure that is",
        "kinematic driven by measured wheel rates, fitted",
    ]
    assert headings[-3:] == ["Faults of the log", "Notes", "What to do next"]
    first = page.partition("</h1>")[2].partition("</p>")[0]
    assert "profile.toml has new numbers of kinematic driven by measured wheel rates" in first
    # nothing is fetched: all pictures are inside
    assert page.count("<img ") == page.count('src="data:image/png;base64,') == 2
    assert not re.findall(r"(?:src|href)=\"(?!data:)", page)


@pytest.mark.usefixtures("one_start")
def test_what_is_no_better_is_not_kept(log: Path, true: Path, tmp_path: Path) -> None:
    """The first two thirds have a left wheel that slips, and what is judged on has none."""
    rows = without_commands(log)
    rows["enc_left"][rows["t"] < 2.0 / 3.0 * rows["t"][-1]] *= 1.1
    bad = write_rows(tmp_path / "bad.csv", rows)
    document = calibrated(bad, tmp_path / "out", "--profile", str(true / "profile.toml"), "--trust")
    assert document["plants"]["kinematic"]["better"] is False
    assert any("keeps the old numbers" in note for note in document["notes"])
    kept, was = (
        load_profile(folder / "profile.toml").plants["kinematic"]
        for folder in (tmp_path / "out", true)
    )
    assert kept.parameters == was.parameters


@pytest.mark.usefixtures("one_start")
def test_a_log_that_contradicts_itself_is_refused_unless_it_is_trusted(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = without_commands(log)
    others = {"enc_left": rows["enc_right"], "enc_right": rows["enc_left"]}
    swapped = write_rows(tmp_path / "swapped.csv", rows | others)
    arguments = [
        str(swapped),
        "--robot",
        "husky",
        "--plants",
        "kinematic",
        "--out",
        str(tmp_path / "out"),
    ]
    assert exit_status(calibrate, *arguments) == 2
    message = capsys.readouterr().err
    assert "enc_left" in message
    assert not (tmp_path / "out" / "calibrate.json").exists()
    trusted = calibrated(swapped, tmp_path / "out", "--robot", "husky", "--trust")
    # poses that follow from the wheels judge no other signal
    assert trusted["faults"][0]["kind"] == "circular"
    assert math.isfinite(trusted["plants"]["kinematic"]["after"]["6"]["position_median_m"])


@pytest.mark.usefixtures("one_start")
def test_a_part_in_which_columns_disagree_is_left_out(tmp_path: Path) -> None:
    """From 40 s on the encoders are swapped; before that the log is as good as the sound one."""
    rows = without_commands(log_path("husky"))
    late = rows["t"] >= rows["t"][0] + 40.0
    left, right = rows["enc_left"], rows["enc_right"]
    sides = {"enc_left": np.where(late, right, left), "enc_right": np.where(late, left, right)}
    sound = {name: column[~late] for name, column in rows.items()}
    found = {}
    for name, columns in (("bad", rows | sides), ("sound", sound)):
        path = write_rows(tmp_path / f"{name}.csv", columns)
        found[name] = calibrate(path, robot="husky", plants=("kinematic",))
    fitted = {name: {p.name: p for p in each.fits[0].parameters} for name, each in found.items()}
    for name, number in fitted["sound"].items():
        error = number.standard_error
        assert fitted["bad"][name].value == pytest.approx(number.value, abs=error), name
    (note,) = [note for note in found["bad"].notes() if "are taken" in note]
    assert 36.0 < float(note.partition(" s are")[0].split()[-1]) < 40.0
    assert open_log(tmp_path / "bad.csv").good_for()["wheels"]
