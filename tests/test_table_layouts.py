"""One motion, written in many ways: as spreadsheets, loggers and people write tables."""

from __future__ import annotations

import csv
import io
import itertools
import math
import random
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from ssmr.types import FloatArray
from tests.conftest import exit_status
from validation.cli.options import _TEXTS
from validation.files.columns import UNITS, count_on, parse_unit
from validation.files.csv_logs import read_csv
from validation.files.formats import read_log
from validation.files.log import Log, ReadOptions
from validation.files.names import taken_by_name
from validation.files.reading import FileError
from validation.recordings import PROGRAM, info

RADIUS = 0.165
TICKS = 90.0
T = 0.02 * np.arange(400)
YAW = 0.8 * np.sin(0.7 * T)
MOTION = {
    "t": T,
    "x": 0.4 * T + 0.1 * np.sin(T),
    "y": 0.3 * np.cos(0.5 * T) - 0.3,
    "yaw": YAW,
    "enc_left": 2.5 + 1.5 * np.sin(0.9 * T),
    "enc_right": 2.5 - 1.5 * np.sin(0.9 * T),
    "gyro_z": 0.56 * np.cos(0.7 * T),
    "cmd_v": 0.4 + 0.1 * np.sin(T),
    "cmd_w": 0.5 * np.cos(0.6 * T),
    "odom_v": 0.4 + 0.1 * np.cos(T),
    "odom_w": 0.5 * np.sin(0.6 * T),
}
# our name: names that others have, each with the factor from our unit to theirs
NAMES: dict[str, Sequence[tuple[str, float]]] = {
    "t": (
        *(("t", 1.0), ("T", 1.0), ("time", 1.0), ("Time (s)", 1.0), ("time (seconds)", 1.0)),
        *(("time_ms", 1e3), ("time [us]", 1e6), ("timestamp_ns", 1e9), ("t [µs]", 1e6)),
        *(("Timestamp [milliseconds]", 1e3), ("elapsed_time_s", 1.0), ("rosbagTimestamp", 1.0)),
        *(
            ("/odom/header/stamp", 1.0),
            ("%time", 1.0),
            ("#timestamp [s]", 1.0),
            ("t [min]", 1 / 60),
            ("seconds", 1.0),
            ("epoch_ms", 1e3),
            ("ts", 1.0),
        ),
    ),
    "x": (
        *(("x", 1.0), ("X", 1.0), ("x [m]", 1.0), ("x (meters)", 1.0), ("x_mm", 1e3)),
        *(("pos_x", 1.0), ("position.x [cm]", 1e2), ("pose.position.x", 1.0), ("posX", 1.0)),
        *(("/odom/pose/pose/position/x", 1.0), ("p_RS_R_x [m]", 1.0), ("x_pos", 1.0), ("tx", 1.0)),
        *(("X Position (ft)", 1 / 0.3048), ("translation_x_km", 1e-3)),
    ),
    "y": (
        *(
            ("y", 1.0),
            ("Y [metres]", 1.0),
            ("y (mm)", 1e3),
            ("py", 1.0),
            ("pose.pose.position.y", 1.0),
        ),
        *(("position_y_in", 1 / 0.0254), ("mocap/pose/y", 1.0), ("translation.y", 1.0)),
    ),
    "yaw": (
        *(("yaw", 1.0), ("yaw_deg", 180 / math.pi), ("yaw [degrees]", 180 / math.pi)),
        *(("heading [°]", 180 / math.pi), ("Yaw (rad)", 1.0), ("theta", 1.0), ("psi_rad", 1.0)),
        *(("/odom/pose/pose/orientation/yaw", 1.0), ("Heading°", 180 / math.pi)),
        *(("yaw (rev)", 0.5 / math.pi), ("yaw [mrad]", 1e3), ("yaw/deg", 180 / math.pi)),
    ),
    "enc_left": (
        *(("enc_left", 1.0), ("enc_left [rad/s]", 1.0), ("enc_left (m/s)", RADIUS)),
        *(("left_wheel_rpm", 30 / math.pi), ("encoderLeft (rad/s)", 1.0), ("left_vel_rad_s", 1.0)),
        *(("wheel_left_velocity", 1.0), ("/joint_states/left_wheel_joint/velocity", 1.0)),
        *(("left wheel speed [deg/s]", 180 / math.pi), ("left_speed_mps", RADIUS)),
        *(
            ("wheel_speed_l [ticks per second]", TICKS / 2 / math.pi),
            ("EncL [rev/s]", 0.5 / math.pi),
        ),
    ),
    "gyro_z": (
        *(("gyro_z", 1.0), ("gyro", 1.0), ("imu_wz", 1.0), ("gyro_z [deg/s]", 180 / math.pi)),
        *(("imu.angular_velocity.z", 1.0), ("/imu/data/angular_velocity/z (rad/s)", 1.0)),
        *(("yaw_rate_dps", 180 / math.pi), ("gyroZ [rad s^-1]", 1.0), ("yawrate", 1.0)),
        *(("imu_angular_velocity_z", 1.0), ("gyro [°/s]", 180 / math.pi), ("gyro_rad_s", 1.0)),
    ),
    "cmd_v": (
        *(("cmd_v", 1.0), ("cmd_vel_linear", 1.0), ("cmd_vel_linear_x", 1.0), ("v_cmd", 1.0)),
        *(("/cmd_vel/twist/linear/x", 1.0), ("cmd_vel.linear.x [m/s]", 1.0), ("linear.x", 1.0)),
        *(("cmd_speed_kmh", 3.6), ("target speed (km/h)", 3.6), ("cmd_v [mm/s]", 1e3)),
        *(("cmd_v_m_per_s", 1.0), ("cmd_vel_x", 1.0), ("commanded speed [m·s⁻¹]", 1.0)),
    ),
    "cmd_w": (
        *(("cmd_w", 1.0), ("cmd_vel_angular", 1.0), ("cmd_vel.angular.z", 1.0), ("w_cmd", 1.0)),
        *(("cmd_yaw_rate", 1.0), ("/cmd_vel/angular/z [deg/s]", 180 / math.pi), ("angular_z", 1.0)),
    ),
    "odom_v": (
        *(("odom_v", 1.0), ("twist_twist_linear_x", 1.0), ("odom.twist.twist.linear.x", 1.0)),
        *(
            ("odom_linear_x", 1.0),
            ("/odom/twist/twist/linear/x", 1.0),
            ("odom_speed [m/min]", 60.0),
        ),
    ),
    "odom_w": (
        *(("odom_w", 1.0), ("twist_twist_angular_z", 1.0), ("odom_angular", 1.0)),
        *(("/odom/twist/twist/angular/z", 1.0), ("odometry yaw rate [rpm]", 30 / math.pi)),
    ),
}
SIDES = {"left": "right", "Left": "Right", "_l ": "_r ", "EncL": "EncR"}
NAMES["enc_right"] = [
    (re.sub("|".join(SIDES), lambda side: SIDES[side[0]], name), size)
    for name, size in NAMES["enc_left"]
]


def written(columns: dict[str, FloatArray], separator: str = ",", point: str = ".") -> str:
    """A table; numbers with a comma are quoted where commas separate."""
    cells = (
        [f"{value:.12g}".replace(".", point) for value in a.tolist()] for a in columns.values()
    )
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, lineterminator="\r\n")
    writer.writerow(columns)
    writer.writerows(zip(*cells, strict=True))
    return text.getvalue()


def read(path: Path, content: str | bytes, **options: object) -> Log:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_log(path, ReadOptions(ticks_per_turn=TICKS, **options), RADIUS)  # type: ignore[arg-type]


def assert_motion(log: Log, names: Sequence[str], tolerance: float = 1e-9) -> None:
    assert set(log.columns) == set(names) - {"t"}, log.remarks
    np.testing.assert_allclose(log.t, T, atol=tolerance, rtol=0)
    for name in log.columns:
        np.testing.assert_allclose(log.columns[name], MOTION[name], atol=tolerance, rtol=1e-9)


def drawn(seed: int) -> tuple[dict[str, FloatArray], list[str]]:
    """Columns of a few names each, and ours of them."""
    draw = random.Random(seed)
    side = draw.randrange(len(NAMES["enc_left"]))
    columns = {}
    for ours, names in NAMES.items():
        name, size = names[side] if ours.startswith("enc") else draw.choice(names)
        columns[name] = MOTION[ours] * size
    shuffled = list(columns)
    draw.shuffle(shuffled)
    return {name: columns[name] for name in shuffled}, list(NAMES)


@pytest.mark.parametrize("seed", range(60))
def test_names_and_units_of_others_are_the_same_motion(tmp_path: Path, seed: int) -> None:
    columns, names = drawn(seed)
    separator, point = random.Random(-seed - 1).choice([*itertools.product(",;\t", ".,")])
    assert_motion(read(tmp_path / "a.csv", written(columns, separator, point)), names)


def test_every_name_alone_is_understood() -> None:
    for ours, names in NAMES.items():
        for name, _ in names:
            pair = [name, name] if ours not in ("enc_left", "enc_right") else []
            if not pair:
                at = next(k for k, (other, _) in enumerate(NAMES[ours]) if other == name)
                pair = [NAMES["enc_left"][at][0], NAMES["enc_right"][at][0]]
            assert name == ours or ours in taken_by_name(pair), name


OTHERS = (
    *(
        "b_w_RS_S_z [rad s^-1]",
        "acc_z",
        "angular_velocity_covariance_8",
        "gyro_x",
        "v_RS_R_x",
        "cmd_vel",
    ),
    *("cmd_vel", "yaw_ref", "goal_pose_x", "target_yaw", "yaw_error", "left_motor_voltage"),
    *("left_cmd_speed", "right_cmd_speed", "left_current", "right_current", "pose_x_std"),
    *(
        "linear_acceleration.x",
        "roll_rate",
        "mag_x",
        "note",
        "calib_step",
        "temperature [°C]",
        "left_pwm",
        "right_pwm",
    ),
)


def test_columns_that_tell_no_motion_are_left_as_they_are() -> None:
    assert taken_by_name(OTHERS) == {}


ENDS = {
    "a mark": lambda text: "\ufeff" + text,
    "UTF-16": lambda text: text.replace(",", "\t").encode("utf-16"),
    "Excel's own line": lambda text: "sep=,\r\n" + text,
    "a preamble": lambda text: "Robot log 2\r\nWritten by me\r\n\r\n" + text,
    "a comment": lambda text: "# " + text.replace(",", " "),
    "spaces in line": lambda text: text.replace(",", "   "),
    "a space behind": lambda text: text.replace(",", ", "),
    "bars": lambda text: text.replace(",", "|"),
    "units below": lambda text: text.replace("\r\n", "\r\ns,m,m,rad\r\n", 1),
    "units below in brackets": lambda text: text.replace("\r\n", "\r\n[s],[m],[m],[rad]\r\n", 1),
    "units above": lambda text: "s,m,m,rad\r\n" + text,
    "topics above": lambda text: "time,pose,pose,pose\r\n" + text,
    "words below": lambda text: text.replace("\r\n", "\r\nstamp,place,place,heading\r\n", 1),
    "a remark below": lambda text: text.replace("\r\n", "\r\n% a drive\r\n", 1),
    "a remark at the end": lambda text: text + "# the end\r\n",
    "old line ends": lambda text: text.replace("\r\n", "\r"),
}


@pytest.mark.parametrize("name", ENDS)
def test_a_table_is_read_however_it_is_wrapped(tmp_path: Path, name: str) -> None:
    poses = {name: MOTION[name] for name in ("t", "x", "y", "yaw")}
    assert_motion(read(tmp_path / "a.csv", ENDS[name](written(poses))), list(poses))


@pytest.mark.parametrize("word", ["-", "--", "#N/A", "NaT", "<NA>", "nil", "?", "None", "NULL"])
def test_a_word_for_nothing_is_a_gap_in_its_column(tmp_path: Path, word: str) -> None:
    text = "t,x,y,yaw\n" + "".join(f"{t},{t},0,0\n" for t in range(9))
    log = read(tmp_path / "a.csv", text.replace("3,3,0,0", f"3,{word},0,0"))
    assert log.columns["x"].tolist() == log.t.tolist() == list(range(9))


def test_signs_of_units_in_an_old_encoding(tmp_path: Path) -> None:
    columns = {"t [µs]": 1e6 * T, "x": MOTION["x"], "yaw [°]": np.degrees(YAW)}
    text = written(columns, ";", ",").encode("cp1252")
    assert_motion(read(tmp_path / "a.csv", text), ["t", "x", "yaw"])


@pytest.mark.parametrize(
    ("unit", "size"),
    [(" [rad]", 1.0), (" [°]", 180 / math.pi), ("_turns", 0.5 / math.pi), (" (meters)", RADIUS)],
)
def test_positions_of_wheels_are_slopes_in_any_unit(tmp_path: Path, unit: str, size: float) -> None:
    way = {name: np.cumsum(MOTION[name]) * 0.02 for name in ("enc_left", "enc_right")}
    columns = {"time (s)": T, "x": MOTION["x"]}
    columns |= {"encoderLeft" + unit: way["enc_left"] * size}
    columns |= {"encoderRight" + unit: way["enc_right"] * size}
    log = read(tmp_path / "a.csv", written(columns))
    for name, values in way.items():
        np.testing.assert_allclose(log.columns[name], np.gradient(values, T), atol=1e-6)


@pytest.mark.parametrize("modulus", [256.0, 360.0, 1000.0, 2400.0, 4096.0, 9000.0, 65536.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_counter_is_counted_on_whatever_it_wraps_by(modulus: float, seed: int) -> None:
    draw = np.random.default_rng(seed)
    rate = np.interp(np.arange(2000), np.arange(0, 2001, 200), draw.uniform(-0.05, 0.09, 11))
    count = np.floor(np.cumsum(rate) * modulus)
    for low in (0.0, -modulus / 2):
        seen = (count - low) % modulus + low
        on, size = count_on(seen, 1.0)
        assert size == modulus
        np.testing.assert_array_equal(np.diff(on), np.diff(count))


def test_what_does_not_wrap_is_left_alone() -> None:
    draw = np.random.default_rng(1)
    for count in (
        np.floor(np.cumsum(draw.uniform(0.0, 0.2, 50))),
        np.floor(np.cumsum(draw.uniform(-1.0, 1.0, 500))),
        np.repeat([0.0, 1.0], 20),
        np.zeros(10),
        np.sin(np.arange(100.0)),
    ):
        assert count_on(count, 1.0)[1] == 0.0


def test_wrapped_ticks_in_a_table_are_rates(tmp_path: Path) -> None:
    count = {
        name: np.floor(np.cumsum(MOTION[name]) * 0.02 * 600) for name in ("enc_left", "enc_right")
    }
    columns = {
        "t": T,
        "x": MOTION["x"],
        "wl": count["enc_left"] % 900,
        "wr": count["enc_right"] % 900,
    }
    named = {"enc_left": ("wl", "ticks"), "enc_right": ("wr", "ticks")}
    log = read(tmp_path / "a.csv", written(columns), columns=named)
    for name, values in count.items():
        exact = np.gradient(values, T) * 2 * math.pi / TICKS
        np.testing.assert_allclose(log.columns[name], exact, atol=1e-6)
    assert any("counts to 900" in remark for remark in log.remarks)


NUMBERS: dict[str, Callable[[str], str]] = {
    "narrow spaces and a comma": lambda text: text.replace(",", "\u202f").replace(".", ","),
    "spaces that do not break": lambda text: text.replace(",", "\u00a0"),
    "thin spaces": lambda text: text.replace(",", "\u2009").replace(".", ","),
    "apostrophes": lambda text: text.replace(",", "'"),
    "typographic apostrophes": lambda text: text.replace(",", "\u2019").replace(".", ","),
    "commas and a point": lambda text: text,
    "points and a comma": lambda text: text.translate(str.maketrans(",.", ".,")),
    "a minus that is none": lambda text: text.replace(",", "").replace("-", "\u2212"),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_digits_in_groups_of_three_are_the_same_number(tmp_path: Path, name: str) -> None:
    x = 1234.5 * np.cos(T) * 10.0 ** (np.arange(len(T)) % 6 - 2)
    write = NUMBERS[name]
    rows = (f"{write(f'{t:.2f}')};{write(f'{v:,.4f}')}" for t, v in zip(T, x, strict=True))
    log = read(tmp_path / "a.csv", "\n".join(["t;x", *rows]))
    np.testing.assert_allclose(log.columns["x"], x, atol=1e-4)


@pytest.mark.parametrize(
    "cell", ["12 34", "1 2345", "1'23", "1 234'567", "1:2", "1:2:3", "-:10:00"]
)
def test_digits_that_are_no_groups_are_no_number(tmp_path: Path, cell: str) -> None:
    with pytest.raises(FileError, match="wanted a finite number"):
        read(tmp_path / "a.csv", f"t;x\n0;1\n1;{cell}\n2;3\n")


TIMES: dict[str, Callable[[float], str]] = {
    "hours": lambda t: f"{t // 3600:02.0f}:{t // 60 % 60:02.0f}:{t % 60:06.3f}",
    "hours and a comma": lambda t: TIMES["hours"](t).replace(".", ","),
    "minutes": lambda t: f"{t // 60:02.0f}:{t % 60:06.3f}",
    "days": lambda t: f"0 days {TIMES['hours'](t)}000",
}


@pytest.mark.parametrize("name", TIMES)
def test_durations_are_seconds(tmp_path: Path, name: str) -> None:
    t = 3540.0 + 1.5 * np.arange(100)
    text = "\n".join(["t;x", *(f"{TIMES[name](s)};0,5" for s in t.tolist())])
    np.testing.assert_allclose(read(tmp_path / "a.csv", text).t, t, atol=1e-9)


# ----------------------------------------------------------------------------- what is to be done
def said_of(path: Path, content: str, **options: object) -> str:
    with pytest.raises(FileError) as refused:
        read(path, content, **options)
    return str(refused.value)


def as_said(text: str) -> dict[str, tuple[str, str]]:
    """The columns of the first option in a message, as the command line reads them."""
    option = shlex.split(re.search(r"--columns (.*)", text)[1])[0]  # type: ignore[index]
    return _TEXTS[Mapping[str, tuple[str, str]]][1](option.rstrip(";,"))


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("rest", [{}, {"gyro_z": 3}], ids=["one clock", "empty cells"])
def test_time_in_another_unit_has_its_option(
    tmp_path: Path, unit: str, rest: dict[str, int]
) -> None:
    columns = {"t": T / UNITS[unit][1], "x": MOTION["x"]}
    columns |= {name: np.where(np.arange(len(T)) % n, np.nan, T) for name, n in rest.items()}
    text = written(columns).replace("nan", "")
    said = said_of(tmp_path / "a.csv", text)
    log = read(tmp_path / "a.csv", text, columns=as_said(said))
    np.testing.assert_allclose(log.groups["pose"].t, T, atol=1e-9)


@pytest.mark.parametrize("name", ["", "moment", "my clock"])
def test_a_column_that_increases_is_offered_for_time(tmp_path: Path, name: str) -> None:
    text = written({"n": np.arange(400.0), "x": -T, "y": np.sin(T), name: T})
    log = read(tmp_path / "a.csv", text, columns=as_said(said_of(tmp_path / "a.csv", text)))
    np.testing.assert_allclose(log.t, T, atol=1e-9)


def test_rows_without_time_are_offered_no_count_of_rows(tmp_path: Path) -> None:
    text = written({"": np.arange(400.0), "x": np.sin(T)})
    assert "--columns t=NAME,x=NAME says" in said_of(tmp_path / "a.csv", text)


@pytest.mark.skipif(shutil.which("awk") is None, reason="there is no awk")
@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(
    "together", ["robots in turn", "robots one after another", "clock set back"]
)
def test_what_is_said_of_time_that_goes_back_runs(
    tmp_path: Path, together: str, separator: str
) -> None:
    path = tmp_path / "two drives.csv"
    robots = ["husky_1"] * len(T) + ["husky_2"] * len(T)
    x = [*T, *(T + 5.0)]
    rows = [",".join(map(str, row)) for row in zip([*T, *T], x, robots, strict=True)]
    if together == "robots in turn":
        rows.sort(key=lambda row: float(row.split(",")[0]))
    if together == "clock set back":
        rows = [row.replace("husky_2", "husky_1") for row in rows]
    said = said_of(path, "\r\n".join(["t,x,robot", *rows]).replace(",", separator))
    assert ("column robot tells apart" in said) == (together != "clock set back")
    command = said[said.index("awk") : said.index(" keeps")]
    subprocess.run(command, shell=True, cwd=tmp_path, check=True)
    np.testing.assert_allclose(read_csv(tmp_path / "part.csv").columns["x"], T)


def test_samples_lost_in_short_bursts_are_bridged_as_it_is_said(tmp_path: Path) -> None:
    t = 0.02 * np.arange(3000)
    columns = {"t": t, "x": np.sin(0.2 * t), "y": np.cos(0.3 * t), "yaw": np.sin(0.25 * t)}
    kept = np.arange(len(t)) % 50 > 5
    path = tmp_path / "bursts.csv"
    path.write_text(written({name: values[kept] for name, values in columns.items()}))
    (lack,) = info(path).inspected.lacks
    (option,) = re.findall(r"convert (--rate \d+)", lack)
    even = tmp_path / "even.csv"
    assert exit_status(PROGRAM, "convert", str(path), *option.split(), "--out", str(even)) == 0
    assert not info(even).inspected.lacks


def test_stamps_that_rows_share_are_counted(tmp_path: Path) -> None:
    whole = said_of(tmp_path / "a.csv", written({"t": np.floor(T), "x": T}))
    assert (
        "392 of 400 rows repeat the stamp before with other numbers; t has lost its fraction"
        in whole
    )
    pairs = said_of(tmp_path / "a.csv", written({"t": np.repeat(T[::2], 2), "x": T}))
    assert "200 of 400 rows repeat the stamp before" in pairs
    assert "fraction" not in pairs


def test_degrees_of_latitude_and_longitude_become_metres(tmp_path: Path) -> None:
    lat = 59.3 + MOTION["y"] / 111_400.0
    lon = 18.0 + MOTION["x"] / 56_975.0
    lat[0] = math.nan
    columns = {"t": T, "lon": lon, "lat": lat, "yaw": YAW}
    path = tmp_path / "a.csv"
    path.write_text(written(columns).replace("nan", ""))
    said = next(note for note in info(path).notes() if "makes metres" in note)
    log = read(path, path.read_text(), columns=as_said(said))
    for name in ("x", "y"):
        away = log.columns[name] - MOTION[name][1:]
        assert np.ptp(away) < 1e-3


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_echoed_joints_have_no_header(tmp_path: Path, parts: int) -> None:
    """A JointState echoed as CSV has no header, and may lack velocities or efforts."""
    joints = "fl_wheel,fr_wheel,rl_wheel,rr_wheel"
    numbers = ("0,0,0,0", "1,2,3,4", "5,6,7,8")[:parts]
    rows = [f"{k // 10},{k % 10 * 100_000_000},,{joints},{','.join(numbers)}" for k in range(9)]
    poses = {"t": ("sec+nanosec", ""), "x": ("fl_wheel.position", "m")}
    log = read(tmp_path / "a.csv", "\n".join(rows), columns=poses)
    np.testing.assert_allclose(log.t, 0.1 * np.arange(9))
    assert ("enc_left" in log.columns) == (parts > 1)
    if parts > 1:
        assert log.columns["enc_left"].tolist() == 9 * [2.0]
        assert log.columns["enc_right"].tolist() == 9 * [3.0]


@pytest.mark.parametrize("frame", ["base_link", ""])
def test_echoed_messages_have_no_header(tmp_path: Path, frame: str) -> None:
    """What `ros2 topic echo --csv` writes of TwistStamped."""
    rows = [f"{k // 10},{k % 10 * 100_000_000},{frame},0.{k},0,0,0,0,-0.{k}" for k in range(9)]
    log = read(tmp_path / "a.csv", "\n".join(rows))
    np.testing.assert_allclose(log.t, 0.1 * np.arange(9))
    np.testing.assert_allclose(log.columns["cmd_v"], 0.1 * np.arange(9))
    np.testing.assert_allclose(log.columns["cmd_w"], -0.1 * np.arange(9))


SAID = {
    "no header": ("0,1,2\n1,2,3\n", "put a line such as t,x,y,yaw above them"),
    "no header, semicolons": ("0,5;1,5\n1,5;2,5\n", "put a line such as t,x,y,yaw above them"),
    "nine numbers": ("0,1,2,3,4,5,6,7,8\n1,2,3,4,5,6,7,8,9\n", "put a line such as"),
    "a bag": (b"SQLite format 3\0" + b"\0" * 100, "let its name end in .db3"),
    "another bag": (b"#ROSBAG V2.0\n" + b"\0" * 100, "let its name end in .bag"),
    "a workbook": (b"PK\x03\x04" + b"\0" * 100, "save the sheet as CSV"),
    "both signs": ("t;x\n0;1,5\n1;2.5\n", "write all decimals with the same sign"),
    "doubled": ("t,x,x\n0,1,2\n1,2,3\n", "twice; each needs a name of its own"),
    "one column": ("x\n1\n2\n", "wanted commas, semicolons, tabs or spaces"),
}


@pytest.mark.parametrize("name", SAID)
def test_what_cannot_be_read_says_what_to_do(tmp_path: Path, name: str) -> None:
    content, words = SAID[name]
    with pytest.raises(FileError, match=words.replace(".", r"\.")):
        read(tmp_path / "a.csv", content)


@pytest.mark.parametrize("ending", [".bag", ".mcap", ".tum", ".txt"])
def test_a_bag_under_another_name_is_known(tmp_path: Path, ending: str) -> None:
    with pytest.raises(FileError, match=r"let its name end in \.db3"):
        read(tmp_path / f"a{ending}", b"SQLite format 3\0" + b"\0" * 100)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("yaw [gon]", "not understood"),
        ("yaw [km/h]", "cannot be in 'km/h'"),
        ("gyro_deg", "cannot be in 'deg'"),
        ("enc_left [A]", "cannot be in 'A'"),
        ("x (in map)", "not understood"),
    ],
)
def test_a_unit_that_does_not_fit_is_said(tmp_path: Path, name: str, words: str) -> None:
    log = read(tmp_path / "a.csv", written({"t": T, "cmd_v": MOTION["cmd_v"], name: YAW}))
    assert any(words in remark for remark in log.remarks)


def test_ticks_without_their_number_are_said_and_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(written({"time": T, "x": T, "left_ticks": T, "right_ticks": T}))
    log = read_csv(path)
    assert set(log.columns) == {"x"}
    assert any("--ticks-per-turn" in remark for remark in log.remarks)


def test_units_are_products_of_prefixes_and_roots() -> None:
    expected = {"mm": ("m", 1e-3), "km/h": ("m/s", 1 / 3.6), "rpm": ("rad/s", math.pi / 30)}
    expected |= {"mph": ("m/s", 0.44704), "min": ("s", 60.0), "in": ("m", 0.0254)}
    for unit, (base, factor) in expected.items():
        assert UNITS[unit] == (base, pytest.approx(factor))
    for text in ("m/s^2", "m s^-2", "g", "mV", "N m", "Nm", "mA", "1", "-"):
        assert parse_unit(text) is not None, text
    for text in ("gon", "foo", "m/m", "°C", "frame"):
        assert parse_unit(text) is None, text
