"""Faults that a log shows by itself, in `recordings info` and in windows that span no jump."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pytest

from ssmr.estimation.settings import EkfSettings
from ssmr.robot.drive import wheel_rates
from ssmr.types import FloatArray
from tests.conftest import data_folder, exit_status, processor_time
from validation.compare import compare
from validation.files import motion
from validation.files.columns import COMMAND_COLUMNS, POSE_COLUMNS
from validation.files.csv_logs import write_csv
from validation.files.formats import log_path, read_log
from validation.files.inspection import AFTER_COMMAND_S, Inspected
from validation.files.log import Log
from validation.files.motion import JUMP_M, JUMP_RAD
from validation.fit import fit
from validation.recordings import PROGRAM, info

DT = 0.05
SPEEDS = {"m/s": 1.0, "km/h": 3.6, "ft/s": 1.0 / 0.3048, "mm/s": 1e3, "m/min": 60.0}
TURNS = {"deg/s": 180.0 / np.pi, "rpm": 30.0 / np.pi, "rad/min": 60.0}
WAYS = {"mm": 1e3, "cm": 1e2, "ft": 1.0 / 0.3048, "in": 1.0 / 0.0254}
RATES = ("gyro_z", "cmd_w", "enc_left", "enc_left enc_right")
SIGNS = (
    "gyro_z",
    "yaw",
    "cmd_v",
    "cmd_w",
    "cmd_v cmd_w",
    "enc_left",
    "enc_right",
    "enc_left enc_right",
)
"""Numbers that a logger in another unit writes for one of ours, and columns that are tried with
them."""


def drive(seconds: float = 60.0, slow: float = 1.0, speed: float = 1.0) -> dict[str, FloatArray]:
    """Columns of a robot without delay, with a localiser of 10 Hz in a log of 20 Hz."""
    t = DT * np.arange(round(seconds / DT))
    v = speed * (0.4 + 0.2 * np.sin(0.5 * t))
    w = 0.5 * np.sin(0.3 * t) * slow
    yaw = np.cumsum(w) * DT
    x = np.cumsum(v * np.cos(yaw)) * DT
    y = np.cumsum(v * np.sin(yaw)) * DT
    left, right = wheel_rates(v, w, 1.8 * EkfSettings.half_track, EkfSettings.radius)  # it skids
    rng = np.random.default_rng(3)
    noise = 0.007 * rng.standard_normal((3, len(t)))
    left, right = np.array([left, right]) + 0.02 * rng.standard_normal((2, len(t)))
    pose = np.repeat((np.array([x, y, yaw]) + noise)[:, ::2], 2, axis=1)[:, : len(t)]
    named = {"cmd_v": v, "cmd_w": w, "enc_left": left, "enc_right": right, "gyro_z": w}
    return {"t": t, **named, **dict(zip(("x", "y", "yaw"), pose, strict=True))}


def faults_of(columns: dict[str, FloatArray]) -> Inspected:
    return Inspected(Log.of_columns("log.csv", columns))


def scaled(factor: float, *names: str) -> Callable[[dict[str, FloatArray]], dict[str, FloatArray]]:
    return lambda columns: {**columns, **{name: factor * columns[name] for name in names}}


def swapped(a: str, b: str) -> Callable[[dict[str, FloatArray]], dict[str, FloatArray]]:
    return lambda columns: {**columns, a: columns[b], b: columns[a]}


def delayed(
    seconds: float, *names: str
) -> Callable[[dict[str, FloatArray]], dict[str, FloatArray]]:
    return lambda c: {**c, **{n: np.interp(c["t"] - seconds, c["t"], c[n]) for n in names}}


def frozen(*names: str) -> Callable[[dict[str, FloatArray]], dict[str, FloatArray]]:
    """Keep columns as they are in the middle of the log from there on."""
    return lambda columns: {
        **columns,
        **{n: columns[n][np.minimum(np.arange(len(columns[n])), 500)] for n in names},
    }


def with_jumps(
    columns: dict[str, FloatArray], jumps: dict[float, float], name: str = "x"
) -> dict[str, FloatArray]:
    """The columns, with the localiser moved by so much from each time on."""
    moved = sum(size * (columns["t"] >= at - 1e-9) for at, size in jumps.items())
    return {**columns, name: columns[name] + moved}


def test_a_sound_log_has_no_faults() -> None:
    measured = faults_of(drive())
    assert measured.sentences() == []
    assert measured.jumps is not None
    assert len(measured.jumps.t) == 0
    assert measured.uncommanded_share == 0.0


@pytest.mark.parametrize(
    ("name", "size"), [("x", 3.0 * JUMP_M), ("y", -2.0 * JUMP_M), ("yaw", 2.0 * JUMP_RAD)]
)
def test_jumps_are_found_where_they_are(name: str, size: float) -> None:
    at = [7.3, 20.0, 20.1, 41.5]
    measured = faults_of(with_jumps(drive(), dict.fromkeys(at, size), name)).jumps
    assert measured is not None
    np.testing.assert_allclose(measured.t, at)
    steps = measured.radians if name == "yaw" else measured.metres
    # the robot itself drives up to 0.06 m; noise of both poses
    np.testing.assert_allclose(steps, abs(size), atol=0.13)


def test_a_localiser_that_stalls_and_catches_up_does_not_jump() -> None:
    # while it stalls, its poses are new ones
    columns, creep = drive(speed=5.0), 1e-6 * np.arange(1200)
    since = np.where(columns["t"] % 6.0 < 1.0, np.round((columns["t"] % 6.0) / DT), 0.0).astype(int)
    measured = faults_of(
        {**columns, **{name: columns[name][np.arange(1200) - since] + creep for name in ("x", "y")}}
    ).jumps
    assert measured is not None
    assert len(measured.t) == 0
    assert measured.caught_up >= 5


def test_a_fast_robot_slides_on_when_its_wheels_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    columns = drive(speed=5.0)
    columns |= {n: np.where(abs(columns["t"] - 15.8) < 1.3, 0.0, columns[n]) for n in WHEELS}
    for least, jumps in ((2.0, False), (np.inf, True)):
        monkeypatch.setattr(motion, "_SLIDES_V", least)
        assert ("jumps" in " ".join(faults_of(columns).sentences())) == jumps


def test_motion_through_a_gap_is_no_jump() -> None:
    columns = drive()
    keep = (columns["t"] < 20.0) | (columns["t"] > 24.0)
    measured = faults_of({n: a[keep] for n, a in columns.items()}).jumps
    assert measured is not None
    assert len(measured.t) == 0


def test_commands_say_how_fast_a_robot_without_encoders_is() -> None:
    columns = {n: a for n, a in drive().items() if not n.startswith("enc")}
    jumped = faults_of(with_jumps(columns, {30.0: 1.0}))
    assert jumped.jumps is not None
    assert jumped.jumps.t.tolist() == pytest.approx([30.0])
    assert jumped.uncommanded_share is None
    assert faults_of({n: a for n, a in columns.items() if not n.startswith("cmd")}).jumps is None


def test_driving_without_commands_is_measured() -> None:
    columns = drive()
    for name in ("cmd_v", "cmd_w"):
        columns[name] = np.where(columns["t"] < 15.0, 0.0, columns[name])
    share = faults_of(columns).uncommanded_share
    assert share == pytest.approx(15.0 / 60.0, abs=0.02)


def test_wheels_may_follow_a_command_late() -> None:
    columns = drive()
    commanded = (columns["t"] % 10.0) < 5.0
    follows = ((columns["t"] - 0.6 * AFTER_COMMAND_S) % 10.0) < 5.0 + 0.3 * AFTER_COMMAND_S
    for names, there in ((("cmd_v", "cmd_w"), commanded), (("enc_left", "enc_right"), follows)):
        for name in names:
            columns[name] = np.where(there, columns[name], 0.0)
    assert faults_of(columns).uncommanded_share == 0.0


@pytest.mark.parametrize("name", ["gyro_z", "yaw", "current_left", "acc_x", "enc_left"])
def test_a_column_that_never_changes_is_dead_only_while_the_robot_moves(name: str) -> None:
    columns = drive()
    zeros = np.zeros_like(columns["t"])
    dead = {**columns, name: zeros}
    assert faults_of(dead).dead_columns == (name,)
    standing = {n: a if n == "t" else zeros for n, a in dead.items()}
    assert faults_of(standing).dead_columns == ()


WHEELS = COMMAND_COLUMNS["wheels"]
TWIST = COMMAND_COLUMNS["twist"]
Spoil = Callable[[dict[str, FloatArray]], dict[str, FloatArray]]


def mistakes(radius: float) -> dict[str, tuple[str, str, Spoil]]:
    """Return loggers' mistakes for a wheel radius [m]: kind of fault, columns, function."""
    return {
        **{
            f"{n} negated": ("sign", n, scaled(-1.0, *n.split()))
            for n in (*SIGNS, "cmd_v cmd_w", "enc_left enc_right", "x y")
        },
        **{
            f"{n} negated": ("handedness", n, scaled(-1.0, *n.split())) for n in ("x", "y", "y yaw")
        },
        **{
            f"{a} and {b} swapped": ("swapped", f"{a} {b}", swapped(a, b))
            for a, b in (WHEELS, ("x", "y"), ("cmd_v", "cmd_w"))
        },
        "wheels swapped and negated": (
            "swapped",
            "enc_left",
            lambda c: swapped(*WHEELS)(scaled(-1.0, *WHEELS)(c)),
        ),
        "compass": ("handedness", "yaw", lambda c: {**c, "yaw": 0.5 * np.pi - c["yaw"]}),
        "compass of degrees": (
            "scale",
            "yaw",
            lambda c: {**c, "yaw": (90.0 - np.degrees(c["yaw"])) % 360.0},
        ),
        "gyro of negative deg/s": ("scale", "gyro_z", scaled(-180.0 / np.pi, "gyro_z")),
        "left wheel negative, of rpm": (
            "scale",
            "enc_left",
            lambda c: scaled(30.0 / np.pi, *WHEELS)(scaled(-1.0, "enc_left")(c)),
        ),
        "commands of percent": (
            "scale",
            "cmd_v",
            lambda c: scaled(143.0, "cmd_w")(scaled(166.0, "cmd_v")(c)),
        ),
        "north, east, down": (
            "handedness",
            "gyro_z",
            lambda c: (
                swapped("x", "y")(scaled(-1.0, "yaw", "gyro_z")(c))
                | {"yaw": 0.5 * np.pi - c["yaw"]}
            ),
        ),
        "yaw and gyro clockwise": ("handedness", "gyro_z", scaled(-1.0, "yaw", "gyro_z")),
        **{
            f"pose late by {seconds} s": (
                "clock",
                "yaw",
                delayed(seconds, *POSE_COLUMNS),
            )
            for seconds in (1.8, 2.5, -4.0)
        },
        "yaw from the y axis": (
            "handedness",
            "yaw",
            lambda c: {**c, "yaw": c["yaw"] - 0.5 * np.pi},
        ),
        "yaw of the rear": ("sign", "yaw", lambda c: {**c, "yaw": c["yaw"] + np.pi}),
        **{
            f"wheels in {u}": ("scale", "enc_left enc_right", scaled(f * radius, *WHEELS))
            for u, f in SPEEDS.items()
        },
        **{
            f"{n} in {u}": ("scale", n, scaled(f, *n.split()))
            for n in RATES
            for u, f in TURNS.items()
        },
        **{
            f"cmd_v in {u}": ("scale", "cmd_v", scaled(f, "cmd_v"))
            for u, f in SPEEDS.items()
            if u != "m/s"
        },
        **{f"x and y in {u}": ("scale", "x y", scaled(f, "x", "y")) for u, f in WAYS.items()},
        "yaw in degrees": ("scale", "yaw", scaled(180.0 / np.pi, "yaw")),
        "one wheel twice": ("same", "enc_right", lambda c: {**c, "enc_right": c["enc_left"]}),
        "yaw in wrapped degrees": (
            "scale",
            "yaw",
            lambda c: {**c, "yaw": np.degrees(c["yaw"]) % 360.0},
        ),
        "pose of another clock": (
            "clock",
            "yaw",
            lambda c: {**c, **{n: np.roll(c[n], 60) for n in POSE_COLUMNS}},
        ),
        "t twice as fast": ("clock", "t", scaled(0.5, "t")),
        "rows counted for t": (
            "clock",
            "t",
            lambda c: {**c, "t": np.arange(0.0, len(c["t"]))},
        ),
        "x and y in degrees of latitude": ("scale", "x y", scaled(1.0 / 111e3, "x", "y")),
        "half the rate of one side": ("scale", "enc_left", scaled(0.5, "enc_left")),
        "t in minutes": ("clock", "t", scaled(1.0 / 60.0, "t")),
        "t in ms of ms": ("clock", "t", scaled(1e-3, "t")),
        **{
            f"{n} frozen": ("frozen", n, frozen(*n.split()))
            for n in ("x y", "yaw", "gyro_z", "enc_left")
        },
        **{f"{n} zero": ("frozen", n, scaled(0.0, n)) for n in ("y", "yaw", "gyro_z", "enc_right")},
        "gyro shows another axis": (
            "swapped",
            "gyro_z",
            lambda c: {**c, "gyro_z": np.sin(0.9 * c["t"]) * np.ptp(c["gyro_z"])},
        ),
    }


UNSEEN = {"wheels in km/h", "wheels in ft/s"}
"""Mistakes that do not show where nobody knows the radius of the wheels: such rates are those of a
robot that does not skid. A wheel of 0.30 m turns by nearly as many rad/s as its rim makes km/h, or
feet a second."""


def shipped() -> list[str]:
    """Return the names of the logs that travel with the package."""
    return [name for name in ("sample", "husky", "warthog") if log_path(name).is_file()]


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", shipped())
def test_mistakes_of_loggers_are_named_and_a_sound_log_is_not_blamed(
    name: str, every: bool
) -> None:
    """Mistakes are shared out among the logs; the slow test tries each on all of them."""
    log = read_log(name).on_one_clock()
    columns = {"t": log.t, **log.columns}
    assert faults_of(columns).faults == ()
    missed = set()
    tried = {
        mistake: made
        for k, (mistake, made) in enumerate(
            mistakes(0.3 if name == "warthog" else EkfSettings.radius).items()
        )
        if every or shipped()[k % len(shipped())] == name
    }
    for mistake, (kind, names, spoil) in tried.items():
        measured = faults_of(spoil(dict(columns))).faults
        if not any(f.kind == kind and set(names.split()) & set(f.columns) for f in measured):
            missed.add(mistake)
    assert missed == UNSEEN & {*tried}


def turned(
    columns: dict[str, FloatArray], place: float, yaw: float, about: complex
) -> dict[str, FloatArray]:
    """The columns, with a place that turns about a point by so much a second, and a heading."""
    turn = np.exp(1j * place * columns["t"])
    moved = about + turn * (columns["x"] + 1j * columns["y"] - about)
    return {**columns, "x": moved.real, "y": moved.imag, "yaw": columns["yaw"] + yaw * columns["t"]}


@pytest.mark.parametrize("about", [0.0, 30.0 - 40.0j])
@pytest.mark.parametrize(("place", "yaw"), [(0.02, 0.0), (0.0, -0.02), (-0.03, -0.03), (0.1, 0.0)])
def test_a_frame_that_turns_is_named_with_its_rates(
    place: float, yaw: float, about: complex
) -> None:
    measured = faults_of(turned(drive(), place, yaw, about))
    (fault,) = measured.faults
    said = [float(number) for number in re.findall(r"by (-?[0-9.]+)", fault.sentence)]
    assert said == pytest.approx([place, yaw], abs=0.003)
    named = ("frame", POSE_COLUMNS) if place else ("drift", ("yaw",))
    assert (fault.kind, fault.columns) == named
    assert measured.fatal


def with_pose(
    columns: dict[str, FloatArray], along: float, side: float, yaw: FloatArray
) -> dict[str, FloatArray]:
    """The columns of a localiser ahead and to the side of the robot [m], with other headings."""
    place = columns["x"] + 1j * columns["y"] + (along + 1j * side) * np.exp(1j * columns["yaw"])
    return {**columns, "x": place.real, "y": place.imag, "yaw": yaw}


def to_and_fro() -> dict[str, FloatArray]:
    """Columns of a robot that drives backwards for a third of the time."""
    columns = drive()
    t = columns["t"]
    v = np.where(t % 15.0 > 10.0, -0.4, columns["cmd_v"])
    yaw = np.cumsum(columns["cmd_w"]) * DT
    left, right = wheel_rates(v, columns["cmd_w"], 1.8 * EkfSettings.half_track, EkfSettings.radius)
    noise = 0.003 * np.random.default_rng(4).standard_normal((3, len(t)))
    place = np.cumsum(v * np.exp(1j * yaw)) * DT
    moved = {"x": place.real + noise[0], "y": place.imag + noise[1], "yaw": yaw + noise[2]}
    return {**columns, **moved, "cmd_v": v, "enc_left": left + noise[0], "enc_right": right}


def test_rows_in_reverse_order_are_one_fault() -> None:
    columns = to_and_fro()
    backwards = {n: a if n == "t" else a[::-1] for n, a in columns.items()}
    (fault,) = faults_of(backwards).faults
    assert (fault.kind, fault.columns) == ("sign", POSE_COLUMNS)
    assert "t runs backwards" in fault.sentence


@pytest.mark.parametrize("name", ["x", "y"])
@pytest.mark.parametrize("seconds", [0.6, 2.0, -1.0])
def test_one_coordinate_alone_that_is_late_is_named_with_its_delay(
    name: str, seconds: float
) -> None:
    (fault,) = faults_of(delayed(seconds, name)(to_and_fro())).faults
    assert (fault.kind, fault.columns) == ("clock", (name,))
    late = float(re.findall(r"[0-9.]+ s", fault.sentence)[0][:-2])
    assert late == pytest.approx(abs(seconds), abs=0.21)


@pytest.mark.parametrize("since", [25.0, 30.0, 45.0])
def test_commands_that_are_not_obeyed_from_a_time_on_are_told_so(since: float) -> None:
    columns = to_and_fro()
    stops = columns["t"] > since
    last = int(np.argmax(stops))
    columns |= {n: np.where(stops, 0.0, columns[n]) for n in (*WHEELS, "gyro_z")}
    noise = 0.003 * np.random.default_rng(6).standard_normal((3, len(stops)))
    for name, extra in zip(POSE_COLUMNS, noise, strict=True):
        columns[name] = np.where(stops, columns[name][last] + extra, columns[name])
    (fault,) = faults_of(columns).faults
    assert (fault.kind, fault.columns) == ("unrelated", TWIST)
    assert fault.from_s == pytest.approx(since, abs=2.0)


@pytest.mark.parametrize("turn", [0.0, 1.0, -2.5])
def test_two_runs_in_one_log_are_a_jump_and_no_delay(turn: float) -> None:
    columns = to_and_fro()
    later = columns["t"] > 30.0
    place = np.exp(1j * turn) * (columns["x"] + 1j * columns["y"]) + 5.0 - 3.0j
    columns |= {
        "x": np.where(later, place.real, columns["x"]),
        "y": np.where(later, place.imag, columns["y"]),
        "yaw": columns["yaw"] + turn * later,
    }
    measured = faults_of(columns)
    assert measured.faults == ()
    assert measured.jumps is not None
    assert len(measured.jumps.t) == 1


def sound_frames() -> dict[str, Spoil]:
    """Logs whose path is never quite where the heading points, though nothing turns."""

    def with_slope(c: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {**c, "y": c["y"] - 0.04 * c["t"]}

    def with_course(c: dict[str, FloatArray]) -> dict[str, FloatArray]:
        place = np.convolve(c["x"] + 1j * c["y"], np.full(21, 1 / 21.0), "same")
        course = np.unwrap(np.angle(np.gradient(place)))
        return {n: a[20:-20] for n, a in {**c, "yaw": course}.items()}

    return {
        "on a slope": with_slope,
        "on a steep slope": lambda c: {**c, "y": c["y"] - 0.2 * c["t"]},
        "mounted at an angle": lambda c: {**c, "yaw": c["yaw"] + 0.1},
        "off the middle": lambda c: with_pose(c, 0.4, -0.3, c["yaw"]),
        "course over ground": with_course,
        "iron near the compass": lambda c: {**c, "yaw": c["yaw"] + 0.04 * np.sin(c["yaw"])},
    }


@pytest.mark.parametrize("name", sound_frames())
def test_no_frame_turns_where_path_and_heading_differ_for_another_reason(name: str) -> None:
    assert faults_of(sound_frames()[name](drive())).faults == ()


@pytest.mark.parametrize("side", [0.5, -0.5])
@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_an_antenna_to_the_side_is_slower_in_turns_to_it(side: float, speed: float) -> None:
    columns = drive(slow=3.0, speed=speed)
    assert faults_of(with_pose(columns, 0.0, side, columns["yaw"])).faults == ()


@pytest.mark.parametrize("noise", [0.001, 0.003, 0.01])
def test_what_creeps_while_a_robot_turns_on_the_spot_tells_no_unit(noise: float) -> None:
    """Wheels and localiser tell different tiny ways of their middles."""
    rng = np.random.default_rng(1)
    n = 2400
    t = DT * np.arange(n)
    w = np.convolve(np.repeat(rng.uniform(-0.8, 0.8, 30), 80), np.full(10, 0.1), "same")
    creep = np.convolve(rng.normal(0.0, 0.05, n), np.full(20, 0.05), "same") * np.abs(w)
    yaw = np.cumsum(w) * DT
    place = np.cumsum((creep + 0.03j * w) * np.exp(1j * yaw)) * DT
    pose = np.array([place.real, place.imag, yaw]) + noise * rng.standard_normal((3, n))
    half = 1.8 * EkfSettings.half_track
    sides = np.array(wheel_rates(0.3 * creep, w, half, EkfSettings.radius))
    left, right = sides + 0.03 * rng.standard_normal((2, n))
    named = {"enc_left": left, "enc_right": right, "gyro_z": w, "cmd_v": 0.0 * w, "cmd_w": w}
    columns = {"t": t, **named, **dict(zip(("x", "y", "yaw"), pose, strict=True))}
    assert faults_of(columns).faults == ()


@pytest.mark.parametrize(("until", "kinds"), [(20.0, ["slip"]), (60.0, [])])
def test_a_robot_that_slips_in_all_turns_is_on_such_ground(until: float, kinds: list[str]) -> None:
    columns = drive()
    turn = columns["gyro_z"]
    slips = (np.abs(turn) > 0.45) & (columns["t"] < until)
    more = 3.0 * slips * turn * EkfSettings.half_track / EkfSettings.radius
    sides = {"enc_left": columns["enc_left"] - more, "enc_right": columns["enc_right"] + more}
    assert [fault.kind for fault in faults_of({**columns, **sides}).faults] == kinds


def test_commands_of_turns_in_degrees_are_told_by_their_factor_and_their_unit() -> None:
    (fault,) = faults_of(scaled(180.0 / np.pi, "cmd_w")(drive())).faults
    assert "cmd_w tells 57." in fault.sentence
    assert "it seems to be in deg/s: --columns cmd_w=cmd_w:deg/s" in fault.sentence


def test_stamps_of_another_unit_are_judged_as_soon() -> None:
    """They do not make delays likely that are longer than the log."""
    log = read_log("sample").on_one_clock()
    taken = []
    for unit in (1.0, 1.0, 1e-3):  # the first one imports
        began = processor_time()
        assert bool(faults_of({"t": unit * log.t, **log.columns}).faults) is (unit < 1.0)
        taken.append(processor_time() - began)
    assert taken[2] < 5.0 * taken[1]


@pytest.mark.parametrize(
    ("unit", "words"),
    [("km/h", "it seems to be in km/h"), ("ft/s", "wheels of another radius than 0.165 m")],
)
def test_a_known_radius_shows_the_unit_of_wheel_rates(unit: str, words: str) -> None:
    log = read_log("husky").on_one_clock()
    radius = EkfSettings.radius
    spoiled = scaled(SPEEDS[unit] * radius, *WHEELS)({"t": log.t, **log.columns})
    (found,) = Inspected(Log.of_columns("log.csv", spoiled), radius).faults
    assert found.kind == "scale"
    assert words in found.sentence


@pytest.mark.parametrize(
    "missing", [(), ("gyro_z",), TWIST, WHEELS, POSE_COLUMNS, ("gyro_z", *TWIST)]
)
def test_a_part_of_a_sound_log_is_not_blamed(missing: tuple[str, ...]) -> None:
    for name in shipped():
        log = read_log(name).on_one_clock()
        for start in np.arange(log.t[0], log.t[-1] - 25.0, 20.0):
            part = log.cut(start, start + 25.0)
            there = {n: a for n, a in part.columns.items() if n not in missing}
            assert faults_of({"t": part.t, **there}).faults == (), (name, start)


def test_degrees_that_turn_by_much_a_sample_are_named_as_such() -> None:
    turned = np.degrees(6.0 * DT) * np.arange(1200)  # 17 degrees a sample
    spun = {
        "t": DT * np.arange(1200),
        "gyro_z": np.full(1200, 6.0),
        "yaw": (turned + 180.0) % 360.0 - 180.0,
    }
    assert ("scale", ("yaw",)) in [
        (f.kind, f.columns) for f in faults_of(spun | {"cmd_w": spun["gyro_z"]}).faults
    ]


def test_commands_on_grass_come_before_the_motion_that_follows_them_slowly() -> None:
    path = data_folder() / "warthog_grass" / "warthog_grass_train.csv"
    if not path.is_file():
        pytest.skip(f"there is no {path}")
    whole = read_log(path)
    for start in (60.0, 150.0):
        assert Inspected(whole.cut(start, start + 45.0)).faults == ()


def test_units_of_positions_show_on_ice_where_wheels_hardly_tell_the_way() -> None:
    path = data_folder() / "drive_runs" / "warthog_ice_train.csv"
    if not path.is_file():
        pytest.skip(f"there is no {path}")
    log = read_log(path).on_one_clock()
    for unit in ("cm", "mm"):
        measured = faults_of(scaled(WAYS[unit], "x", "y")({"t": log.t, **log.columns})).faults
        assert {(f.kind, f.columns) for f in measured} == {
            ("sign", ("gyro_z",)),
            ("scale", ("x", "y")),
        }


@pytest.mark.parametrize(
    ("held", "kind", "blamed"),
    [
        (WHEELS, "frozen", WHEELS),
        (WHEELS[1:], "frozen", WHEELS[1:]),
        ((*WHEELS, *TWIST), "slip", WHEELS),
        (("gyro_z",), "frozen", ("gyro_z",)),
    ],
)
def test_sensors_that_are_dead_for_a_while_are_told_from_a_robot_that_is_pushed(
    held: tuple[str, ...], kind: str, blamed: tuple[str, ...]
) -> None:
    log = read_log("sample").on_one_clock()
    start = log.t[0] + 0.5 * (log.t[-1] - log.t[0])
    stands = (log.t > start) & (log.t < start + 8.0)
    columns = {n: np.where(stands & (n in held), 0.0, a) for n, a in log.columns.items()}
    (measured,) = faults_of({"t": log.t, **columns}).faults
    assert (measured.kind, measured.columns) == (kind, blamed)


def test_a_heading_that_was_lost_is_no_log_that_never_turns() -> None:
    log = read_log("sample").on_one_clock()
    found = faults_of({"t": log.t, **log.columns, "yaw": 0.0 * log.t})
    assert "quaternion" in found.faults[0].sentence
    assert all("heading" in sentence for sentence in found.lacks)


def test_two_signals_that_contradict_each_other_are_both_named() -> None:
    columns = {n: a for n, a in drive().items() if n in ("t", *WHEELS, *POSE_COLUMNS)}
    (measured,) = faults_of(swapped(*WHEELS)(columns)).faults
    assert {*WHEELS, "yaw"} <= set(measured.columns)


def follow_advice(columns: dict[str, FloatArray], path: Path) -> tuple[str, list[str]]:
    """Return what is said of a log, and the kinds that are left once its options were pasted."""
    write_csv(columns, path)
    paste: list[str] = []
    said = []
    for _ in range(2):
        out = path.with_name(f"{len(said)}.json")
        given = ["info", str(path), *paste, "--robot", "husky", "--json", str(out)]
        assert exit_status(PROGRAM, *given) == 0
        faults = json.loads(out.read_text())["faults"]
        said.append(" ".join(fault["sentence"] for fault in faults))
        paste = " ".join(re.findall(r"--columns \S+|--ticks-per-turn [0-9.]+", said[0])).split()
    assert paste, said
    return said[0], [fault["kind"] for fault in faults]


@pytest.mark.parametrize("unit", ["rpm", "deg/s", "m/s"])
def test_a_unit_between_two_figures_is_named_with_options_that_cure_it(
    unit: str, tmp_path: Path
) -> None:
    """The turn that wheels tell is uncertain; a unit between it and the way is the one."""
    size = {"rpm": 30.0 / np.pi, "deg/s": 180.0 / np.pi, "m/s": EkfSettings.radius}[unit]
    said, left = follow_advice(scaled(size, *WHEELS)(drive()), tmp_path / "log.csv")
    assert f"enc_left=enc_left:{unit}" in said
    assert left == []


@pytest.mark.parametrize("ticks", [600, 4096])
@pytest.mark.parametrize("wraps", [False, True])
def test_counts_of_wheels_come_with_their_number_in_a_turn(
    ticks: int, wraps: bool, tmp_path: Path
) -> None:
    columns = drive()
    counts = {n: np.cumsum(columns[n]) * DT * ticks / (2.0 * np.pi) for n in WHEELS}
    if wraps:
        counts = {n: (a + 500.0) % 8192.0 for n, a in counts.items()}
    said, left = follow_advice({**columns, **counts}, tmp_path / "log.csv")
    found = re.search(r"--ticks-per-turn ([0-9.]+)", said)
    assert found is not None
    assert float(found[1]) == pytest.approx(ticks, rel=0.02)
    assert left == []


@pytest.mark.parametrize("step", [0.1, 0.2])
def test_stamps_that_were_rounded_are_refused_with_a_command_that_works(
    step: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    columns = drive()
    path = tmp_path / "log.csv"
    table = pandas.DataFrame({**columns, "t": np.floor(columns["t"] / step + 1e-9) * step})
    table.to_csv(path, index=False)
    assert exit_status(PROGRAM, "info", str(path)) == 2
    found = re.search(r"awk [^>]* > part.csv", " ".join(capfd.readouterr().err.split()))
    assert found is not None
    subprocess.run(found[0], shell=True, check=True, cwd=tmp_path)
    assert Inspected(read_log(tmp_path / "part.csv")).faults == ()


def test_compare_and_fit_warn_and_score_as_if_there_were_no_jump(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    errors = []
    costs = []
    settings = {"input": "wheels", "horizons": (6.0,)}
    for name, jumps in (("sound", {}), ("jumped", {10.0: 5.0, 45.0: -3.0})):
        path = tmp_path / f"{name}.csv"
        write_csv(with_jumps(drive(), jumps), path)
        compared = compare(str(path), plants=("kinematic",), workers=1, **settings)
        fitted = fit(
            "kinematic",
            path,
            input="wheels",
            free=("wheel_radius",),
            population=5,
            generations=1,
            workers=1,
        )
        message = (
            capsys.readouterr().err.splitlines(),
            compared.notes(),
            compared.as_dict()["notes"],
            fitted.as_dict()["notes"],
        )
        warned = [
            any("jumps 2 times" in sentence for sentence in sentences) for sentences in message
        ]
        assert warned == [name == "jumped"] * len(message)
        errors.append(compared.scores["kinematic"].horizons[6.0].position_p95_m)
        costs.append(fitted.cost)
    assert abs(errors[1] - errors[0]) < 0.5  # of 5 m
    # every fifth window of 6 s would span a jump: 0.5 m on average
    assert abs(costs[1] - costs[0]) < 0.15


def test_info_writes_what_it_found(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    write_csv({**with_jumps(drive(), {10.0: 5.0}), "gyro_z": np.zeros(1200)}, path)
    report = info(path)
    report.write(tmp_path / "new" / "info.json")
    document = json.loads((tmp_path / "new" / "info.json").read_text())
    assert document["schema"] == "ssmr.info/1"
    assert document["pose_jumps"] == 1
    assert document["uncommanded_share"] == 0.0
    assert document["dead_columns"] == ["gyro_z"]
    assert set(document["offsets_s"]) == {"wheels", "pose_yaw", "position"}
    assert "gyro_z" in report.table()
    with pytest.raises(ValueError, match="the log itself"):
        report.write(path)
