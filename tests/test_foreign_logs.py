"""Tables and trajectories of others, read as they come; what small tests say; what a log lacks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest

from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.types import FloatArray
from tests import bag_factory
from validation.files.columns import COMMAND_COLUMNS
from validation.files.csv_logs import read_csv
from validation.files.formats import log_path, read_log, write_log
from validation.files.inspection import Inspected, open_log
from validation.files.log import Log, ReadOptions
from validation.files.reading import FileError

T = 0.1 * np.arange(200)
YAW = 0.5 * np.sin(0.4 * T)
WHEELS = COMMAND_COLUMNS["wheels"]
Columns = dict[str, FloatArray]


def table(path: Path, columns: dict[str, object]) -> Path:
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def dates() -> list[str]:
    start = np.datetime64("2026-01-02T03:04:05", "ns")
    return [str(start + np.timedelta64(round(1e9 * t), "ns")).replace("T", " ") for t in T]


FOREIGN: dict[str, dict[str, object]] = {
    "PlotJuggler": {
        "__time": 1.7e9 + T,
        "/odom/pose/pose/position/x": T,
        "/odom/pose/pose/position/y": 0.0 * T,
        "/odom/pose/pose/orientation/yaw": YAW,
    },
    "rostopic": {
        "%time": np.int64(1_700_000_000_000_000_000) + np.rint(1e9 * T).astype(np.int64),
        "field.pose.pose.position.x": T,
        "field.pose.pose.position.y": 0.0 * T,
        "field.pose.pose.orientation.x": 0.0 * T,
        "field.pose.pose.orientation.y": 0.0 * T,
        "field.pose.pose.orientation.z": np.sin(0.5 * YAW),
        "field.pose.pose.orientation.w": np.cos(0.5 * YAW),
    },
    "seconds and nanoseconds": {
        "sec": 1_700_000_000 + T.astype(int),
        "nanosec": np.rint(1e9 * (T % 1.0)).astype(int),
        "position.x": T,
        "position.y": 0.0 * T,
        "yaw": YAW,
    },
    "units in the header": {
        "t [ms]": 1e3 * T,
        "x [m]": T,
        "y": 0.0 * T,
        "yaw [deg]": np.degrees(YAW),
    },
    "dates": {"t": dates(), "x": T, "y": 0.0 * T, "yaw": YAW},
}


@pytest.mark.parametrize("name", FOREIGN)
def test_a_table_of_others_is_the_motion_that_it_tells(tmp_path: Path, name: str) -> None:
    log = read_csv(table(tmp_path / "log.csv", FOREIGN[name]))
    since = log.t - log.t[0]
    np.testing.assert_allclose(since, T, atol=1e-5)
    np.testing.assert_allclose(log.columns["x"], T, atol=1e-9)
    np.testing.assert_allclose(log.columns["yaw"], YAW, atol=1e-9)


def test_columns_can_be_means_and_positions(tmp_path: Path) -> None:
    ticks = np.round(4096 * 0.3 * T)
    columns = {"t": T, "x": T, "fl": 1.0 + T, "rl": 3.0 + T, "fr": ticks, "rr": ticks}
    path = table(tmp_path / "log.csv", columns)
    named = {"enc_left": ("fl+rl", ""), "enc_right": ("fr+rr", "ticks")}
    log = read_csv(path, ReadOptions(columns=named, ticks_per_turn=4096))
    np.testing.assert_allclose(log.columns["enc_left"], 2.0 + T)
    np.testing.assert_allclose(log.columns["enc_right"], 0.6 * np.pi, atol=0.02)
    with pytest.raises(FileError, match="--ticks-per-turn N"):
        read_csv(path, ReadOptions(columns=named))


def test_torques_of_a_side_add_up_whether_named_or_guessed(tmp_path: Path) -> None:
    wheels = ("front_left", "rear_left", "front_right", "rear_right")
    columns = {"__time": T}
    for k, wheel in enumerate(wheels):
        columns[f"/joint_states/{wheel}_wheel/velocity"] = (k + 1.0) * T
        columns[f"/joint_states/{wheel}_wheel/effort"] = (k + 1.0) * YAW
    guessed = read_csv(table(tmp_path / "theirs.csv", columns))
    named = {"torque_left": ("fl+rl", ""), "torque_right": ("fr+rr", "")}
    own = dict(zip(("t", "fl", "rl", "fr", "rr"), (T, YAW, 2 * YAW, 3 * YAW, 4 * YAW), strict=True))
    path = table(tmp_path / "ours.csv", {**own, "x": T})
    log = read_csv(path, ReadOptions(columns=named))
    for torques in (guessed.columns, log.columns):
        np.testing.assert_allclose(torques["torque_left"], 3.0 * YAW)
        np.testing.assert_allclose(torques["torque_right"], 7.0 * YAW)
    np.testing.assert_allclose(guessed.columns["enc_left"], 1.5 * T)


def test_repeated_rows_are_left_out_and_words_for_nothing_are_gaps(tmp_path: Path) -> None:
    x: list[object] = [*T]
    x[50] = "NaN"
    path = table(tmp_path / "log.csv", {"t": np.repeat(T, 2), "x": np.repeat(x, 2)})
    log = read_csv(path)
    assert len(log.groups["pose"].t) == len(T) - 1
    assert any("200 rows repeat" in remark for remark in log.remarks)


def test_time_that_lost_its_fraction_is_said_so(tmp_path: Path) -> None:
    path = table(tmp_path / "log.csv", {"t": (1.7e9 + T).astype(np.float32), "x": T})
    with pytest.raises(FileError, match="t has lost its fraction"):
        read_csv(path)


def test_a_trajectory_comes_back(tmp_path: Path) -> None:
    write_log(Log.of_columns("a", {"t": T, "x": T, "y": -T, "yaw": YAW}), tmp_path / "a.tum")
    log = read_log(tmp_path / "a.tum")
    np.testing.assert_allclose(log.columns["yaw"], YAW, atol=1e-8)
    # of a camera: x to the right, y down, z ahead
    rows = np.zeros((len(T), 12))
    rows[:, 0] = rows[:, 10] = np.cos(YAW)
    rows[:, 8] = np.sin(YAW)
    rows[:, 2] = -np.sin(YAW)
    rows[:, 5] = 1.0
    rows[:, 3] = T
    rows[:, 11] = 2.0 * T
    np.savetxt(tmp_path / "kitti.txt", rows)
    log = read_log(tmp_path / "kitti.txt")
    np.testing.assert_allclose(log.columns["x"], 2.0 * T)
    np.testing.assert_allclose(log.columns["y"], -T)
    np.testing.assert_allclose(log.columns["yaw"], YAW, atol=1e-9)


MEDIA = ("csv", "tum", "mcap")


def written_poses(folder: Path, medium: str, quats: FloatArray) -> Path:
    """A file of poses that are turned by (M, 4) quaternions, w last."""
    path = folder / f"a.{medium}"
    if medium == "csv":
        quat = {f"q{axis}": quats[:, k] for k, axis in enumerate("xyzw")}
        return table(path, {"t": T, "x": T, "y": -T, **quat})
    if medium == "tum":
        np.savetxt(path, np.column_stack([T, T, -T, 0.0 * T, quats]), fmt="%.17g")
        return path
    messages: list[bag_factory.Message] = []
    for t, quat in zip(T.tolist(), quats.tolist(), strict=True):
        pose = {"position": {"x": t, "y": -t}, "orientation": dict(zip("xyzw", quat, strict=True))}
        made = "geometry_msgs/msg/PoseStamped", bag_factory.stamped(t, pose=pose)
        messages.append(("/pose", t, made))
    return bag_factory.write(folder, medium, messages)


@pytest.mark.parametrize("medium", MEDIA)
def test_the_length_of_a_quaternion_turns_nothing(tmp_path: Path, medium: str) -> None:
    quats = yaw_to_quat_wxyz(YAW)[:, [1, 2, 3, 0]]
    sizes = 10.0 ** np.random.default_rng(1).uniform(-9.0, 9.0, (len(T), 1))
    log = read_log(written_poses(tmp_path, medium, sizes * quats))
    np.testing.assert_allclose(log.columns["yaw"], YAW, atol=1e-9)


@pytest.mark.parametrize("medium", MEDIA)
def test_a_quaternion_without_length_is_no_heading_of_zero(tmp_path: Path, medium: str) -> None:
    quats = yaw_to_quat_wxyz(1.0 + YAW)[:, [1, 2, 3, 0]]
    quats[100] = 0.0
    assert read_log(written_poses(tmp_path, medium, quats)).columns["yaw"].min() > 0.0


@pytest.mark.parametrize("column", [0, slice(4, 8)])
def test_a_trajectory_needs_two_poses(tmp_path: Path, column: int | slice) -> None:
    path = written_poses(tmp_path, "tum", yaw_to_quat_wxyz(YAW))
    rows = np.loadtxt(path)
    rows[:, column] = 0.0
    np.savetxt(path, rows)
    with pytest.raises(FileError, match="fewer than two poses"):
        read_log(path)


def spiked(c: Columns) -> Columns:
    values = c["enc_left"].copy()
    values[100::150] += 60.0
    return {**c, "enc_left": values}


def added_up(c: Columns) -> Columns:
    dt = np.diff(c["t"], prepend=c["t"][0])
    return {**c, **{name: np.cumsum(c[name] * dt) for name in WHEELS}}


def turned(c: Columns) -> Columns:
    way = np.exp(0.5j) * (c["x"] + 1j * c["y"])
    return {**c, "x": way.real, "y": way.imag}


def moved_poses(warp: Callable[[FloatArray], FloatArray]) -> Callable[[Columns], Columns]:
    """Poses of other instants."""
    return lambda c: {**c, **{n: np.interp(warp(c["t"]), c["t"], c[n]) for n in ("x", "y", "yaw")}}


def averaged(c: Columns) -> Columns:
    """Poses averaged over 2 s."""
    width = round(2.0 / float(np.median(np.diff(c["t"]))))
    mean = np.full(width, 1.0 / width)
    return {**c, **{n: np.convolve(c[n], mean, mode="same") for n in ("x", "y", "yaw")}}


def wrapped(c: Columns, name: str) -> Columns:
    """A rate that goes on at the other end of two thirds of its range."""
    most = float(np.max(np.abs(c[name]))) * 2.0 / 3.0
    return {**c, name: (c[name] + most) % (2.0 * most) - most}


def on_a_stone(c: Columns) -> Columns:
    """The left wheels turn three times as fast in a third of the time."""
    third = len(c["t"]) // 3
    faster = np.ones(len(c["t"]))
    faster[third : 2 * third] = 3.0
    return {**c, "enc_left": faster * c["enc_left"]}


def from_half_on(change: Callable[[Columns], Columns]) -> Callable[[Columns], Columns]:
    """Columns that are changed in the second half of a log."""

    def changed(c: Columns) -> Columns:
        late = np.arange(len(c["t"])) >= len(c["t"]) // 2
        return {name: np.where(late, values, c[name]) for name, values in change(c).items()}

    return changed


def low_passed(c: Columns) -> Columns:
    """A gyro that follows by 1 s."""
    rates = np.zeros(len(c["t"]))
    for k in range(1, len(rates)):
        share = -np.expm1(-(c["t"][k] - c["t"][k - 1]))
        rates[k] = rates[k - 1] + share * (c["gyro_z"][k] - rates[k - 1])
    return {**c, "gyro_z": rates}


def grown(c: Columns) -> Columns:
    """Ways by the pose that grow to two and a half times through a log."""
    factor = np.linspace(1.0, 2.5, len(c["t"]))
    steps = {name: factor * np.diff(c[name], prepend=c[name][0]) for name in ("x", "y")}
    return {**c, **{name: c[name][0] + np.cumsum(each) for name, each in steps.items()}}


def asked(c: Columns) -> Columns:
    """Set points of a driver whose answers come up to three rows after the commands, by chance."""
    rows = np.arange(len(c["t"]))
    since = np.floor(5.0 * c["t"])  # commands come at 5 Hz
    told = {name: c[name][np.searchsorted(since, since)] for name in ("cmd_v", "cmd_w")}
    at = np.maximum(rows - np.random.default_rng(0).integers(0, 4, len(rows)), 0)
    turn = 0.4 * told["cmd_w"][at]
    sides = dict(zip(WHEELS, (told["cmd_v"][at] - turn, told["cmd_v"][at] + turn), strict=True))
    return {**c, **told, **{name: side / 0.165 for name, side in sides.items()}}


INVENTED: dict[str, tuple[str, Callable[[Columns], Columns]]] = {
    "a gyro's offset": ("offset", lambda c: {**c, "gyro_z": c["gyro_z"] + 0.1}),
    "a gyro's drift": (
        "drift",
        lambda c: {**c, "gyro_z": c["gyro_z"] + np.linspace(-0.1, 0.1, len(c["t"]))},
    ),
    "a small offset": ("offset", lambda c: {**c, "gyro_z": c["gyro_z"] - 0.04}),
    "poses of 5 s later": ("clock", moved_poses(lambda t: t + 5.0)),
    "a clock that is fast": ("clock", moved_poses(lambda t: 1.03 * t)),
    "poses averaged": ("smoothed", averaged),
    "a side that slips": ("slip", on_a_stone),
    "encoders without a sign": ("sign", lambda c: {**c, **{n: abs(c[n]) for n in WHEELS}}),
    "spikes": ("spikes", spiked),
    "positions": ("positions", added_up),
    "a path at an angle": ("frame", turned),
    "one column twice": ("same", lambda c: {**c, "enc_right": c["enc_left"]}),
    "rows for t": ("clock", lambda c: {**c, "t": np.arange(float(len(c["t"])))}),
    "half of the angle": ("scale", lambda c: {**c, "yaw": 0.5 * c["yaw"]}),
    "one axis in mm": ("scale", lambda c: {**c, "y": 1e3 * c["y"]}),
    "a scale that grows": ("scale", grown),
    "a curvature": (
        "curvature",
        lambda c: {**c, "cmd_w": c["cmd_w"] / np.where(abs(c["cmd_v"]) > 0.05, c["cmd_v"], 1.0)},
    ),
    "clipped wheels": (
        "clipped",
        lambda c: {
            **c,
            **{n: c[n].clip(*0.5 * np.ptp(c[n]) * np.array([-0.5, 0.5])) for n in WHEELS},
        },
    ),
    "wheels clipped in most of the log": (
        "clipped",
        lambda c: {**c, **{n: c[n].clip(*0.15 * np.ptp(c[n]) * np.array([-1, 1])) for n in WHEELS}},
    ),
    "a gyro behind a filter": ("smoothed", low_passed),
    "a side that is late": (
        "clock",
        lambda c: {**c, "enc_left": np.interp(c["t"] - 0.6, c["t"], c["enc_left"])},
    ),
    "swapped from half on": (
        "swapped",
        from_half_on(lambda c: {**c, "enc_left": c["enc_right"], "enc_right": c["enc_left"]}),
    ),
    "a gyro whose clock is fast": (
        "clock",
        lambda c: {**c, "gyro_z": np.interp(1.03 * c["t"], c["t"], c["gyro_z"])},
    ),
    "a gyro that wraps": ("counter", lambda c: wrapped(c, "gyro_z")),
    "wheels that wrap": ("counter", lambda c: wrapped(wrapped(c, "enc_left"), "enc_right")),
    "a gyro that is held": (
        "frozen",
        lambda c: {
            **c,
            "gyro_z": c["gyro_z"][np.searchsorted(c["t"], np.floor(0.5 * c["t"]) / 0.5)],
        },
    ),
    "commands of another driver from half on": (
        "unrelated",
        from_half_on(lambda c: {**c, **{n: c[n][::-1] for n in ("cmd_v", "cmd_w")}}),
    ),
    "a side that counts a fifth more": ("scale", lambda c: {**c, "enc_left": 1.2 * c["enc_left"]}),
    "set points": ("setpoints", asked),
    "a gear of 22": ("scale", lambda c: {**c, **{name: 22.0 * c[name] for name in WHEELS}}),
}


@pytest.mark.parametrize("name", INVENTED)
def test_a_fault_has_its_kind_and_its_numbers(name: str) -> None:
    kind, spoil = INVENTED[name]
    log = read_log("husky").on_one_clock()
    columns = spoil({"t": log.t, **log.columns})
    found = Inspected(Log.of_columns("log.csv", columns), 0.165).faults
    assert kind in [fault.kind for fault in found]
    assert len(found) <= 2
    if name == "swapped from half on":
        half = log.t[len(log.t) // 2]
        assert found[0].from_s == pytest.approx(half, abs=3.0)
    if name == "commands of another driver from half on":
        # in the middle, those from the end are like these
        assert found[0].from_s == pytest.approx(log.t[len(log.t) // 2], abs=5.0)
    if name == "a gear of 22":
        assert "a gear of about 20" in found[0].sentence
    if name == "a side that is late":
        assert "enc_left tells of motions 0.6 s after" in found[0].sentence


@pytest.mark.parametrize("digits", [12, 4, 3])
@pytest.mark.parametrize("name", ["husky", "sample", "warthog"])
def test_a_pose_is_circular_however_noisy_its_rates_and_with_few_digits(
    name: str, digits: int
) -> None:
    log = read_log(name).on_one_clock()
    dt = np.diff(log.t, prepend=log.t[0])
    left, right = (log.columns[side] for side in WHEELS)
    for turn in (0.3 * (right - left), log.columns["gyro_z"]):
        yaw = np.cumsum(turn * dt)
        way = np.cumsum(0.08 * (left + right) * dt * np.exp(1j * yaw))
        pose = {"x": way.real, "y": way.imag, "yaw": yaw}
        rounded = {column: values.round(digits) for column, values in pose.items()}
        found = Inspected(Log.of_columns("log.csv", {"t": log.t, **log.columns, **rounded})).faults
        assert [fault.kind for fault in found] == ["circular"]


def test_signals_that_agree_outvote_the_one_that_does_not() -> None:
    log = read_log("husky").on_one_clock()
    columns = {"t": log.t, **log.columns}
    for name in ("gyro_z", "yaw"):
        (found,) = Inspected(
            Log.of_columns("log.csv", {**columns, name: 2.0 * columns[name]})
        ).faults
        assert found.columns == (name,)
        assert found.kind == "scale"


def test_parts_tell_radii_and_width_where_they_can() -> None:
    log = read_log("sample").on_one_clock()
    columns = {"t": log.t, **log.columns}
    half = np.arange(len(log.t)) >= len(log.t) // 2
    for name in WHEELS:  # smaller wheels from half on turn faster
        columns[name] = columns[name] * np.where(half, 1.25, 1.0)
    parts = Inspected(Log.of_columns("log.csv", columns)).parts
    assert [part["from_s"] for part in parts[1:]] == [part["to_s"] for part in parts[:-1]]
    early = np.median([p["wheel_radius_left"] for p in parts[:2] if p["wheel_radius_left"]])
    late = np.median([p["wheel_radius_left"] for p in parts[-2:] if p["wheel_radius_left"]])
    assert early / late == pytest.approx(1.25, rel=0.05)


DRIVES: dict[str, tuple[FloatArray, FloatArray, str]] = {
    "standing": (0.0 * T, 0.0 * T, "stands"),
    "straight": (0.5 + 0.1 * np.sin(T), 0.0 * T, "never turns"),
    "on the spot": (0.0 * T, 0.5 * np.sin(0.4 * T), "on the spot"),
    "a circle": (0.5 + 0.0 * T, 0.4 + 0.0 * T, "one constant circle"),
    "to one side": (0.5 + 0.1 * np.sin(T), 0.3 + 0.2 * np.sin(T), "to one side only"),
    "well": (0.5 + 0.1 * np.sin(T), 0.5 * np.sin(0.4 * T), ""),
}


@pytest.mark.parametrize("name", DRIVES)
def test_a_log_says_what_it_cannot_tell(name: str) -> None:
    v, w, wanted = DRIVES[name]
    yaw = 0.1 * np.cumsum(w)
    # a localiser has noise, or its poses would follow from the wheels
    noise = np.random.default_rng(1).normal(0.0, 0.005, (2, len(T)))
    x = 0.1 * np.cumsum(v * np.cos(yaw)) + noise[0]
    y = 0.1 * np.cumsum(v * np.sin(yaw)) + noise[1]
    sides = {"enc_left": (v - 0.5 * w) / 0.165, "enc_right": (v + 0.5 * w) / 0.165}
    log = Log.of_columns("log.csv", {"t": T, "x": x, "y": y, "yaw": yaw, **sides})
    inspected = Inspected(log)
    assert len(inspected.lacks) == bool(wanted)
    assert not wanted or wanted in inspected.lacks[0]
    assert inspected.good_for()["wheels"] == (not wanted)
    (short,) = Inspected(log.cut(0.0, 5.0)).lacks
    assert "too short for a window of 6 s" in short


def test_what_no_mistake_explains_is_said_with_its_number() -> None:
    """A place that sways by 0.8 m has no wrong unit, sign or frame; the sound log passes."""
    sound = pandas.read_csv(log_path("husky"))
    assert not open_log(sound).faults
    t = sound["t"]
    sways = sound.assign(x=sound["x"] + 0.8 * np.sin(t), y=sound["y"] + 0.8 * np.cos(0.7 * t))
    (fault,) = open_log(sways).faults
    assert fault.kind == "disagree"
    assert {"x", "y"} <= {*fault.columns}
    assert "no mistake that is looked for explains it" in fault.sentence
    assert float(fault.sentence.partition("disagree by ")[2].split()[0]) > 2.0


def test_noise_of_a_robot_that_stands_is_no_fault() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 40.0, 0.02)
    names = ("enc_left", "enc_right", "gyro_z", "x", "y", "yaw")
    noise = dict(zip(names, 0.003 * rng.standard_normal((len(names), len(t))), strict=True))
    found = Inspected(Log.of_columns("log.csv", {"t": t, **noise}), 0.165)
    assert not found.faults
    assert any("the robot stands" in sentence for sentence in found.lacks)


@pytest.mark.parametrize(
    ("time", "number"), [("{:g} sec", "{:g}"), ("{:g}", "\u2212{:g}")], ids=["MATLAB", "Swedish"]
)
def test_numbers_are_read_as_matlab_and_excel_write_them(
    tmp_path: Path, time: str, number: str
) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{time.format(0.1 * k)};{number.format(0.5 + k)}" for k in range(5)]
    path.write_text("\n".join(["t;gyro_z", *rows]), encoding="utf-8")
    log = open_log(path).log
    np.testing.assert_allclose(log.t, 0.1 * np.arange(5))
    np.testing.assert_allclose(np.abs(log.columns["gyro_z"]), 0.5 + np.arange(5))


@pytest.mark.parametrize("slower", [1.0, 0.6, 0.2])
@pytest.mark.parametrize(("name", "start"), [("husky", 0.35), ("sample", 0.5), ("warthog", 0.6)])
def test_wheels_of_a_robot_that_is_pushed_are_not_frozen(
    name: str, start: float, slower: float
) -> None:
    log = read_log(name).on_one_clock()
    begin = log.t[0] + start * np.ptp(log.t)
    pushed = (log.t > begin) & (log.t < begin + 0.15 * np.ptp(log.t))
    # it moves so much more slowly then, and the rest of the drive comes later
    share = np.where(pushed, slower, 1.0)
    at = log.t[0] + np.cumsum(share * np.diff(log.t, prepend=log.t[0]))
    columns = {name: np.interp(at, log.t, values) for name, values in log.columns.items()}
    if "gyro_z" in columns:
        columns["gyro_z"] *= share
    for rate in (*WHEELS, "cmd_v", "cmd_w"):
        columns[rate] = np.where(pushed, 0.0, columns[rate])
    found = Inspected(Log.of_columns("log.csv", {"t": log.t, **columns}), None)
    assert {fault.kind for fault in found.faults} <= {"slip"}
    assert found.faults or slower < 0.5
