"""Frames of pandas are logs, and motions are such frames."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import CURRENTS, MOTOR_COLUMNS, VOLTAGES, State, Trajectory
from validation import load_profile, open_source
from validation.calibrate import calibrate
from validation.compare import compare
from validation.files.columns import COLUMNS
from validation.files.csv_logs import read_csv, read_frame
from validation.files.formats import log_path
from validation.files.log import PLAIN, Log
from validation.files.reading import FileError
from validation.fit import fit
from validation.plants.profile import make_plant
from validation.plants.table import PLANTS

CELLS = st.sampled_from([0.25, -1.0, 3, 1e300, float("nan"), float("inf"), "0.5", "x", " ", None])
HEADERS = ("x", "yaw [deg]", "heading", "cmd_v", "enc_left", "bumper", "odom_x", "ä ö", " y", "")


@st.composite
def frames(draw: st.DrawFn) -> pandas.DataFrame:
    """Return a drive whose columns have any names, and in which some cells are anything."""
    rows = draw(st.integers(2, 12))
    t = 0.1 * np.arange(rows)
    frame = pandas.DataFrame({"t": t, "cmd_w": np.sin(t)})
    for name in draw(st.lists(st.sampled_from(HEADERS), unique=True, max_size=4)):
        frame[name] = pandas.Series(np.cos(t), dtype=object)
        for row, cell in draw(st.dictionaries(st.integers(0, rows - 1), CELLS, max_size=3)).items():
            frame.loc[row, name] = cell
    return frame.convert_dtypes() if draw(st.booleans()) else frame


def groups_of(log: Log) -> dict[str, dict[str, list[float]]]:
    """Return all columns of a log with their stamps, by group."""
    found = {}
    for key, group in log.groups.items():
        columns = {name: values.tolist() for name, values in group.columns.items()}
        found[key] = {"t": group.t.tolist(), **columns}
    return found


@given(frames())
def test_a_frame_is_the_log_of_its_csv_file(
    tmp_path_factory: pytest.TempPathFactory, frame: pandas.DataFrame
) -> None:
    path = tmp_path_factory.mktemp("frame") / "frame.csv"
    frame.to_csv(path, index=False)
    outcomes = []
    for read in (lambda: read_csv(path), lambda: read_frame(frame, PLAIN, None)):
        try:
            log = read()
            outcomes.append((groups_of(log), list(log.remarks)))
        except FileError as error:
            outcomes.append(re.sub(r"\d+", "N", f"{error.column}: {error.what}"))
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("name", PLANTS)
def test_a_motion_comes_back_from_its_frame(name: str) -> None:
    plant = make_plant(load_profile("thesis-lab"), name)
    motion = plant.run(TRAJECTORIES["traj4"].commands(), State(x=1.0, yaw=3.0), 0.01)
    (again,) = open_source(motion.frame()).truth
    for part in ("t", "pose", "wheels"):
        np.testing.assert_array_equal(getattr(again, part), getattr(motion, part))
    np.testing.assert_array_equal(again.twist[:, 2], motion.twist[:, 2])


def test_a_recorded_motion_comes_back_with_its_motors() -> None:
    recorded = open_source("warthog", "wheels").truth[0]
    (again,) = open_source(recorded.frame(), "wheels").truth
    for part in ("t", "pose", "wheels"):
        np.testing.assert_array_equal(getattr(again, part), getattr(recorded, part))
    assert recorded.channels.keys() == {CURRENTS, VOLTAGES}
    for channel, values in recorded.channels.items():
        np.testing.assert_array_equal(again.channels[channel], values)


def test_a_frame_has_the_columns_of_a_log_and_numbers_those_that_it_does_not_know() -> None:
    ones = np.ones((3, 4))
    still = np.zeros((3, 3))
    channels = {"wheel_load_N": ones, "yaw_acceleration_rad_s2": ones[:, 0]}
    motion = Trajectory(np.arange(3.0), still, still, ones[:, :2], channels)
    loads = [f"wheel_load_N_{k}" for k in range(4)]
    others = {"t", "v_y", *loads, "yaw_acceleration_rad_s2"}
    assert set(motion.frame()) - others == {
        *("x", "y", "yaw", "odom_v", "odom_w", "gyro_z", "enc_left", "enc_right")
    }
    assert set(motion.frame()) - others <= set(COLUMNS)
    columns = {column for pair in MOTOR_COLUMNS.values() for column in pair}
    assert columns <= set(COLUMNS)


def test_a_comparison_with_a_frame_is_that_with_its_file(tmp_path: Path) -> None:
    frame = pandas.read_csv(log_path("husky"))
    options = {"plants": ("kinematic",), "input": "wheels", "since": 10.0}
    by_file = compare(log_path("husky"), "husky-tile", **options)
    by_frame = compare(frame, "husky-tile", **options)
    pandas.testing.assert_frame_equal(
        by_frame.frame("Error of the relative pose after a horizon"),
        by_file.frame("Error of the relative pose after a horizon"),
    )
    assert "compare.json" in {path.name for path in by_frame.save(tmp_path, recording=False)}
    stamped = frame.set_index("t")
    stamped.attrs["name"] = "monday"
    assert compare(stamped, "husky-tile", **options).title.startswith("monday")


@pytest.mark.parametrize("given", [3, [1.0], np.zeros((4, 2)), pandas.Series([1.0])])
def test_what_is_no_frame_is_refused(given: object) -> None:
    with pytest.raises(ValueError, match=r"source is .*, wanted str \| Path \| DataFrame"):
        compare(given)


FEW: dict[str, Any] = {
    "input": "wheels",
    "search": "lsq",
    "free": ("alpha_l", "alpha_r", "y_l", "y_r"),
    "profile": "husky-tile",
}


@pytest.mark.usefixtures("one_start")
def test_fits_and_calibrations_of_a_frame_are_those_of_its_file(tmp_path: Path) -> None:
    """Without commands, whose driver takes many fits."""
    frame = pandas.read_csv(log_path("husky")).drop(columns=["cmd_v", "cmd_w"])
    path = tmp_path / "husky.csv"
    frame.to_csv(path, index=False)
    fits = [fit("kinematic", to=given, **FEW) for given in (frame, path, [frame], [path])]
    assert len({tuple(p.value for p in fitted.parameters) for fitted in fits}) == 1
    assert fits[0].asked.names == ["frame"]
    by_frame, by_file = (
        calibrate(given, robot="husky", plants=("kinematic",)) for given in ([frame], path)
    )
    pandas.testing.assert_frame_equal(by_frame.frame(), by_file.frame())


@pytest.mark.parametrize("name", [None, "monday", "traj4"])
def test_parts_of_a_frame_are_told_apart(name: str | None) -> None:
    """Parts have the name of the whole, and most frames have none."""
    frame = pandas.read_csv(log_path("husky"))
    if name is not None:
        frame.attrs["name"] = name
    early = frame[frame["t"] < 30.0]
    late = frame[frame["t"] >= 30.0]
    judged = fit("kinematic", to=early, held_out=[late], **FEW)
    assert len(set(judged.train) | set(judged.held_out)) == 2
    both = fit("kinematic", to=[early, late], **FEW)
    assert len(both.train) == 2
    outside = fit("kinematic", to=frame, until=30.0, held_out=[frame], **FEW)
    assert list(outside.train) == list(outside.held_out)
    assert frame.attrs.get("name") == early.attrs.get("name") == late.attrs.get("name") == name
