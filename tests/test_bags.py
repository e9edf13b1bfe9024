"""Bags as streams and as recordings: every generation, every type; what is refused, and how it is said."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssmr.robot.localiser import Localiser
from tests.bag_factory import KINDS, Maker, Message, circle, write
from tests.conftest import ROUNDOFF
from validation.bench.sources import drive, open_source
from validation.files.bags import choose_topics, read_topics, to_local, vertical
from validation.files.formats import is_log, read_log
from validation.files.log import RECORDED, Log, ReadOptions, Topic
from validation.files.reading import FileError
from validation.plants.profile import Profile, make_plant

STAMP = 1e-6
"""Stamps of bags are whole nanoseconds of a Unix time, which a double of seconds keeps to 0.2 microseconds."""


@pytest.fixture(scope="session", params=KINDS)
def bag_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The circle in each kind of bag."""
    return write(tmp_path_factory.mktemp("bags"), request.param, circle)


# ------------------------------------------------------------------------------------------- what is read
def test_a_bag_is_the_motion_that_was_recorded(bag_path: Path) -> None:
    assert is_log(bag_path)
    recording = read_log(bag_path).on_one_clock()
    assert set(RECORDED) <= set(recording.columns)
    yaw = 0.4 * (1.0 + recording.t)
    np.testing.assert_allclose(recording.columns["yaw"], yaw, atol=STAMP)
    np.testing.assert_allclose(recording.columns["x"], 1.25 * np.sin(yaw), atol=STAMP)
    np.testing.assert_allclose(recording.columns["enc_left"], 2.25, rtol=ROUNDOFF)  # of the wheels alone, not of the arm
    np.testing.assert_allclose(recording.columns["enc_right"], 4.25, rtol=ROUNDOFF)
    np.testing.assert_allclose(recording.columns["gyro_z"], 0.4, rtol=ROUNDOFF)  # about the vertical, not about its z
    assert recording.columns["cmd_w"][0] == 0.0  # nobody had commanded yet: the stamp of writing is 10 ms later
    np.testing.assert_allclose(recording.columns["cmd_w"][1:], 0.4, rtol=ROUNDOFF)
    east = 1.25 * (np.sin(yaw) - math.sin(0.4))
    np.testing.assert_allclose(recording.columns["gps_east"], east, atol=1e-4)  # the factory's degrees have six digits
    np.testing.assert_allclose(recording.columns["odom_v"], 0.5, rtol=ROUNDOFF)


def test_compare_and_fit_take_bags_for_recordings(bag_path: Path, lab: Profile) -> None:
    source = open_source(str(bag_path), "wheels", stop=2.0)
    (piece,) = source.pieces
    assert piece.t is not None
    assert piece.t[-1] <= 2.0
    motion = drive(make_plant(lab, "kinematic"), piece, Localiser(), source.sample_dt)
    assert len(motion) == len(piece.t)


TOPICS = {"/cmd_vel", "/fix", "/husky_velocity_controller/odom", "/imu/data", "/joint_states",
          "/vrpn_client_node/husky/pose"}  # fmt: skip


def topics_of(path: Path, **options: object) -> dict[str, Topic]:
    return {topic.name: topic for topic in read_topics(path, ReadOptions(**options))}


def test_every_kind_of_bag_gives_the_same_topics(bag_path: Path) -> None:
    topics = topics_of(bag_path)
    assert {name for name, topic in topics.items() if topic.columns is not None} == TOPICS
    assert (topics["/rosout"].type, len(topics["/rosout"].t)) == ("std_msgs/msg/String", 60)
    for topic in (topics[name] for name in TOPICS):
        assert (len(topic.t), topic.jumps) == (60, [])
        assert np.median(np.diff(topic.t)) == pytest.approx(0.05, abs=STAMP)
        assert topic.stamps == ("bag" if topic.name == "/cmd_vel" else "header")


def test_commands_count_as_zero_once_they_are_old(tmp_path: Path) -> None:
    def silent(make: Maker) -> list[Message]:
        poses = [("/pose", 0.1 * k, make.pose_stamped(0.1 * k, 0.0, 0.0, 0.0)) for k in range(30)]
        return sorted(
            [*poses, *[("/cmd_vel", t, make.twist_stamped(t, 1.0, 0.0)) for t in (0.55, 0.65)]], key=lambda m: m[1]
        )

    recording = read_log(write(tmp_path, "ros1", silent)).on_one_clock()
    driven = recording.columns["cmd_v"] > 0.0
    np.testing.assert_array_equal(driven, (recording.t > 0.55) & (recording.t < 1.15))


# ------------------------------------------------------------------------------------------- topics
def test_topics_are_guessed_by_type_and_by_usual_names(tmp_path: Path) -> None:
    def many(make: Maker) -> list[Message]:
        out: list[Message] = []
        for t in 0.1 * np.arange(20):
            out += [
                ("/odometry/filtered", t, make.odometry(t, (0.0, 0.0, 0.0), 9.0, 0.0)),
                ("/husky_velocity_controller/odom", t, make.odometry(t, (0.0, 0.0, 0.0), 1.0, 0.0)),
                ("/a_first/twist", t, make.twist(9.0, 0.0)),
                ("/husky/cmd_vel", t, make.twist(1.0, 0.0)),
            ]
        return out

    path = write(tmp_path, "mcap", many)
    topics = list(topics_of(path).values())
    chosen = {role: topic.name for role, topic in choose_topics(path, topics, {}).items()}
    assert chosen == {"cmd": "/husky/cmd_vel", "odom": "/husky_velocity_controller/odom"}
    named = choose_topics(path, topics, {"odom": "/odometry/filtered", "cmd": "none"})
    assert {role: topic.name for role, topic in named.items()} == {"odom": "/odometry/filtered"}


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"odometry": "/odom"}, "unknown role 'odometry'; there are: cmd, odom"),
        ({"odom": "/nowhere"}, "no topic /nowhere; there are: /cmd_vel"),
        ({"gps": "/cmd_vel"}, "topic /cmd_vel of geometry_msgs/msg/Twist cannot be gps: wanted latitude or longitude"),
        ({"cmd": "/rosout"}, "nothing can be read from topic /rosout: 60 messages of std_msgs/msg/String"),
    ],
)
def test_wrong_topics_are_refused(bag_path: Path, named: dict[str, str], message: str) -> None:
    with pytest.raises(FileError, match=message) as refused:
        read_log(bag_path, ReadOptions(named))
    assert str(refused.value).startswith(str(bag_path))


# ------------------------------------------------------------------------------------------- faults
def fault(path: Path) -> str:
    with pytest.raises(FileError) as refused:
        read_log(path).on_one_clock()
    text = str(refused.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def poses(ticks: Sequence[tuple[float, float]], value: float = 0.0):
    """Poses at (stamp, written) [s]."""
    return lambda make: [("/pose", written, make.pose_stamped(t, value, 0.0, 0.0)) for t, written in ticks]


def test_a_clock_that_jumps_is_refused_with_the_way_round(tmp_path: Path) -> None:
    path = write(tmp_path, "ros1", poses([(0.1 * k + (0.0 if k < 10 else 30.0), 0.1 * k) for k in range(20)]))
    message = fault(path)
    assert "the clock of topic /pose jumps by +30.000 s after 1.000 s" in message
    assert "stamps bag takes the times of writing; topics pose=none leaves it out" in message
    assert len(read_log(path, ReadOptions(stamps="bag")).t) == 20


def test_late_samples_are_sorted_and_stamps_of_another_clock_are_not_believed(tmp_path: Path) -> None:
    ticks = [(0.1 * k, 0.1 * k + (0.25 if k == 7 else 0.0)) for k in range(20)]
    topic = topics_of(write(tmp_path, "mcap", poses(sorted(ticks, key=lambda m: m[1]))))["/pose"]
    assert np.all(np.diff(topic.t) > 0.0)
    booted = write(tmp_path, "mcap", poses([(0.1 * k - 1e6, 0.1 * k) for k in range(20)]), "booted")
    assert topics_of(booted)["/pose"].stamps == "bag"


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_bag_or_an_empty_one_is_said_so(tmp_path: Path, kind: str) -> None:
    (tmp_path / "folder").mkdir()
    assert "no ROS 2 bag: there is no metadata.yaml in it" in fault(tmp_path / "folder")
    for name in ("text.bag", "text.mcap"):
        (tmp_path / name).write_text("hello, this is no bag at all")
        assert "no bag that can be read, or a damaged one" in fault(tmp_path / name)
    assert "empty" in fault(write(tmp_path, kind, lambda make: [], "empty"))
    talk = write(tmp_path, kind, lambda make: [("/rosout", 0.1 * k, make.text("hello")) for k in range(3)], "talk")
    assert "nothing of use" in fault(talk)


def test_numbers_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "sqlite", poses([(0.1 * k, 0.1 * k) for k in range(5)], math.nan))
    assert "/pose, 0.000 s: x is nan m, wanted a finite number [m]; topics pose=none leaves it out" in fault(path)


def test_topics_that_do_not_overlap_are_refused(tmp_path: Path) -> None:
    def apart(make: Maker) -> list[Message]:
        first = [("/pose", 0.1 * k, make.pose_stamped(0.1 * k, 0.0, 0.0, 0.0)) for k in range(10)]
        return [*first, *[("/imu", 5.0 + 0.1 * k, make.imu(5.0 + 0.1 * k, (0.0, 0.0, 0.0))) for k in range(10)]]

    assert "do not overlap: /imu 5 to 5.9 s, /pose 0 to 0.9 s" in fault(write(tmp_path, "mcap", apart))


@pytest.mark.parametrize("kind", ["ros1", "mcap", "sqlite"])
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_bags_are_read_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, kind: str, data: st.DataObject
) -> None:
    if kind not in _WHOLE:
        whole = write(tmp_path_factory.mktemp("whole"), kind, lambda make: circle(make, 8))
        _WHOLE[kind] = next(whole.glob("*.db3")) if kind == "sqlite" else whole
    whole = _WHOLE[kind]
    damaged = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    damaged = damaged[: data.draw(st.one_of(st.just(len(damaged)), st.integers(0, len(damaged))))]
    path = tmp_path_factory.mktemp("damaged") / whole.name
    path.write_bytes(damaged)
    if kind == "sqlite":
        (path.parent / "metadata.yaml").write_bytes((whole.parent / "metadata.yaml").read_bytes())
        path = path.parent
    try:
        log = read_log(path)
    except FileError as refused:
        assert "\n" not in str(refused)  # noqa: PT017
    else:
        assert isinstance(log, Log)


_WHOLE: dict[str, Path] = {}


# ------------------------------------------------------------------------------------------- geometry
@given(st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), st.floats(-300.0, 300.0), st.floats(-300.0, 300.0))
def test_local_metres_agree_with_the_ellipsoid(latitude: float, longitude: float, east: float, north: float) -> None:
    """Against the chord between two points of WGS 84 in Cartesian coordinates, which is the distance to 1e-9 there."""

    def cartesian(lat: float, lon: float) -> np.ndarray:
        a, f = 6378137.0, 1.0 / 298.257223563
        e2, phi, lam = f * (2.0 - f), math.radians(lat), math.radians(lon)
        n = a / math.sqrt(1.0 - e2 * math.sin(phi) ** 2)
        return np.array(
            [n * math.cos(phi) * math.cos(lam), n * math.cos(phi) * math.sin(lam), n * (1.0 - e2) * math.sin(phi)]
        )

    there = (latitude + north / 111_000.0, longitude + east / (111_000.0 * math.cos(math.radians(latitude))))
    x, y = to_local([latitude, there[0]], [longitude, there[1]])
    distance = float(np.linalg.norm(cartesian(*there) - cartesian(latitude, longitude)))
    # left out is the meridians' convergence, d^2 tan(latitude) / R: 0.16 m for 424 m at 80 degrees
    assert math.hypot(x[1], y[1]) == pytest.approx(distance, abs=1e-6 + 2.0 * distance**2 * 5.7 / 6.37e6)
    assert x[0] == y[0] == 0.0


@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_the_vertical_is_where_gravity_shows(axis: list[float]) -> None:
    up = np.array(axis) / np.linalg.norm(axis)
    columns = {f"acc_{name}": np.full(3, 9.81 * value) for name, value in zip("xyz", up, strict=True)}
    np.testing.assert_allclose(vertical(columns), up, atol=1e-12)
    weightless = {name: 0.1 * values for name, values in columns.items()}
    np.testing.assert_array_equal(vertical(weightless), [0.0, 0.0, 1.0])
