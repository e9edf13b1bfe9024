"""Bags as topics and as logs: every generation, every type; what is refused, and how it is said."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import bag_factory as make
from tests.bag_factory import KINDS, Message, circle, poses_at, write
from tests.conftest import ROUNDOFF
from validation.experiment.sources import open_source
from validation.files.bags import read_topics, to_local
from validation.files.columns import POSE_COLUMNS, RECORDED
from validation.files.formats import is_log, read_log
from validation.files.inspection import Inspected
from validation.files.log import ReadOptions, Topic
from validation.files.reading import FileError
from validation.files.topics import choose_topics

STAMP = 1e-6
"""Stamps of bags are whole nanoseconds of a Unix time, which a double of seconds keeps to 0.2
microseconds."""


@pytest.fixture(scope="session", params=KINDS)
def bag_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The circle in each kind of bag."""
    return write(tmp_path_factory.mktemp("bags"), request.param, circle())


# ------------------------------------------------------------------------------------------- what
# is read
def test_a_bag_is_the_motion_that_was_recorded(bag_path: Path) -> None:
    assert is_log(bag_path)
    log = read_log(bag_path).on_one_clock()
    there = log.columns
    assert set(RECORDED) <= set(there)
    yaw = 0.4 * (1.0 + log.t)
    np.testing.assert_allclose(there["yaw"], yaw, atol=STAMP)
    np.testing.assert_allclose(there["x"], 1.25 * np.sin(yaw), atol=STAMP)
    # of the wheels alone, not of the arm
    np.testing.assert_allclose(there["enc_left"], 2.25, rtol=ROUNDOFF)
    np.testing.assert_allclose(there["enc_right"], 4.25, rtol=ROUNDOFF)
    # about the vertical, not about its z
    np.testing.assert_allclose(there["gyro_z"], 0.4, rtol=ROUNDOFF)
    # writing is late by as much for all: commands without stamps are brought back by that
    np.testing.assert_allclose(there["cmd_w"], 0.4, rtol=ROUNDOFF)
    # of six digits
    np.testing.assert_allclose(there["gps_east"], 1.25 * (np.sin(yaw) - math.sin(0.4)), atol=1e-4)
    np.testing.assert_allclose(there["odom_v"], 0.5, rtol=ROUNDOFF)
    (piece,) = open_source(str(bag_path), "wheels", stop=2.0).pieces
    assert piece.t[-1] <= 2.0


TOPICS = {
    "/cmd_vel",
    "/fix",
    "/husky_velocity_controller/odom",
    "/imu/data",
    "/joint_states",
    "/vrpn_client_node/husky/pose",
}


def topics_of(path: Path, **options: object) -> dict[str, Topic]:
    return {topic.name: topic for topic in read_topics(path, ReadOptions(**options))[0]}


def test_every_kind_of_bag_gives_the_same_topics(bag_path: Path) -> None:
    topics = topics_of(bag_path)
    assert {name for name, topic in topics.items() if topic.columns is not None} == TOPICS
    assert (topics["/rosout"].type, len(topics["/rosout"].t)) == ("std_msgs/msg/String", 60)
    for topic in (topics[name] for name in TOPICS):
        assert len(topic.t) == 60
        assert np.median(np.diff(topic.t)) == pytest.approx(0.05, abs=STAMP)
        assert bool(topic.remark) == (topic.name == "/cmd_vel")


def test_commands_count_as_zero_once_they_are_old(tmp_path: Path) -> None:
    commands = [("/cmd_vel", t, make.twist_stamped(t, 1.0, 0.0)) for t in (0.55, 0.65)]
    log = read_log(
        write(tmp_path, "ros1", sorted([*poses_at(30), *commands], key=lambda m: m[1]))
    ).on_one_clock()
    np.testing.assert_array_equal(log.columns["cmd_v"] > 0.0, (log.t > 0.55) & (log.t < 1.15))


# ------------------------------------------------------------------------------------------- topics
def test_topics_are_guessed_by_type_and_by_usual_names(tmp_path: Path) -> None:
    many: list[Message] = []
    for t in (0.1 * np.arange(20)).tolist():
        many += [
            ("/odometry/filtered", t, make.odometry(t, (0.0, 0.0, 0.0), 9.0, 0.0)),
            ("/husky_velocity_controller/odom", t, make.odometry(t, (0.0, 0.0, 0.0), 1.0, 0.0)),
            ("/a_first/twist", t, make.twist(9.0, 0.0)),
            ("/husky/cmd_vel", t, make.twist(1.0, 0.0)),
        ]
    path = write(tmp_path, "mcap", many)
    topics = list(topics_of(path).values())
    chosen = {role: topic.name for role, topic in choose_topics(path, topics, {})[0].items()}
    wheels = "/husky_velocity_controller/odom"
    assert chosen == {"cmd": "/husky/cmd_vel", "odom": wheels, "pose": wheels}
    wanted = {"odom": "/odometry/filtered", "cmd": "none", "pose": "none"}
    named, _ = choose_topics(path, topics, wanted)
    assert {role: topic.name for role, topic in named.items()} == {"odom": "/odometry/filtered"}


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"odometry": "/odom"}, "unknown role 'odometry'; there are: cmd, odom"),
        ({"odom": "/nowhere"}, "no topic /nowhere; there are: /cmd_vel"),
        (
            {"gps": "/cmd_vel"},
            "topic /cmd_vel of geometry_msgs/msg/Twist cannot be gps: wanted latitude or longitude",
        ),
        (
            {"cmd": "/rosout"},
            "nothing can be read from topic /rosout: 60 messages of std_msgs/msg/String",
        ),
    ],
)
def test_wrong_topics_are_refused(bag_path: Path, named: dict[str, str], message: str) -> None:
    with pytest.raises(FileError, match=message) as refused:
        read_log(bag_path, ReadOptions(topics=named))
    assert str(refused.value).startswith(str(bag_path))


# ------------------------------------------------------------------------------------------- faults
IMU_LATER = [("/imu", 5.0 + 0.1 * k, make.imu(5.0 + 0.1 * k, (0.0, 0.0, 0.0))) for k in range(10)]
FAULTS: dict[str, tuple[list[Message], str]] = {
    "no number": (
        poses_at(value=math.nan),
        "/pose, 0.000 s: x is nan, wanted a finite number [m]; topics pose=none",
    ),
    "no overlap": (
        [*poses_at(10), *IMU_LATER],
        "do not overlap: /imu 5 to 5.9 s, /pose 0 to 0.9 s",
    ),
    "nothing of use": (
        [("/rosout", 0.1 * k, make.text("hello")) for k in range(3)],
        "nothing of use",
    ),
    "nothing": ([], "empty"),
    "one sample": (poses_at(1), "fewer than two samples; topics pose=none leaves it out"),
}


def refused(path: Path, **options: object) -> str:
    """The one line with which a bag is refused."""
    with pytest.raises(FileError) as caught:
        read_log(path, ReadOptions(**options)).on_one_clock()
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("case", FAULTS)
def test_what_cannot_be_used_is_refused_with_the_way_round(tmp_path: Path, case: str) -> None:
    messages, message = FAULTS[case]
    for kind in ("ros1", "mcap"):
        named = {"topics": {"pose": "/pose"}} if case == "one sample" else {}
        path = write(tmp_path, kind, messages)
        assert message in refused(path, **named)


def test_late_samples_are_sorted_and_stamps_of_a_clock_that_jumps_are_not_believed(
    tmp_path: Path,
) -> None:
    def topic(ticks: Sequence[tuple[float, float]], name: str) -> Topic:
        messages = [
            ("/pose", written, make.pose_stamped(t, 0.0))
            for t, written in sorted(ticks, key=lambda m: m[1])
        ]
        return topics_of(write(tmp_path, "mcap", messages, name))["/pose"]

    assert np.all(
        np.diff(
            topic([(0.1 * k, 0.1 * k + (0.25 if k == 7 else 0.0)) for k in range(20)], "late").t
        )
        > 0.0
    )
    booted = topic([(0.1 * k - 1e6, 0.1 * k) for k in range(20)], "booted")
    assert booted.remark == ""  # any origin will do
    log = read_log(write(tmp_path, "mcap", poses_at(jump=30.0), "jumped"))
    np.testing.assert_allclose(log.t, 0.1 * np.arange(20), atol=STAMP)
    assert list(log.remarks) == [
        "/pose: the clock of the messages jumps, so the times of writing count"
    ]


WEAVES = 0.1 * np.arange(400)
"""Stamps of a robot that weaves [s]."""


def weaving(
    rate: float = 1.0, ahead: float = 0.0, sources: Sequence[str] = ("/mocap/pose",)
) -> list[Message]:
    """Messages of a weaving robot on a clock of that rate; poses are so far ahead [s].

    Wheels skid: they turn twice as far as the robot, and the controller believes them.
    """
    v = 0.5 + 0.1 * np.sin(0.3 * WEAVES)
    w = 0.4 * np.sin(0.5 * WEAVES)
    bodies = {1.0: np.cumsum(0.1 * w), 2.0: np.cumsum(0.2 * w)}
    paths = {}
    for factor, yaw in bodies.items():
        x, y = (np.cumsum(0.1 * v * each) for each in (np.cos(yaw), np.sin(yaw)))
        noise = 0.004 * (2.0 - factor) * np.random.default_rng(1).standard_normal((3, len(x)))
        paths[factor] = (np.array([x, y, yaw]) + noise).T.tolist()
    messages = list[Message]()
    for k, t in enumerate(WEAVES.tolist()):
        slip = 0.01 * math.sin(7.0 * t)  # so that wheels are no set points
        sides = {"fl_wheel": (v[k] - w[k]) / 0.2 + slip, "fr_wheel": (v[k] + w[k]) / 0.2 + slip}
        now = [("/joint_states", make.joints(t, sides)), ("/cmd_vel", make.twist(v[k], w[k]))]
        now.append(("/odom", make.odometry(t, paths[2.0][k], v[k], 2.0 * w[k])))
        now += [(name, make.pose_stamped(t + ahead, *paths[1.0][k])) for name in sources]
        now.append(("/move_base/goal", make.pose_stamped(t, 5.0)))
        messages += [(name, t / rate, made) for name, made in now]
    return messages


def test_a_simulations_clock_counts_and_commands_are_brought_onto_it(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, "mcap", weaving(rate=0.6)))
    for name in ("wheels", "pose", "cmd"):
        np.testing.assert_allclose(log.groups[name].t, WEAVES, atol=1e-3)
    assert any("0.6 times as fast" in remark for remark in log.remarks)
    assert not log.faults


@pytest.mark.parametrize("ahead", [20.0, -59.0])
def test_a_topic_of_another_clock_is_said_and_put_right(tmp_path: Path, ahead: float) -> None:
    log = read_log(write(tmp_path, "mcap", weaving(ahead=ahead)))
    (fault,) = log.faults
    assert (fault.kind, fault.columns) == ("clock", POSE_COLUMNS)
    assert f"{abs(ahead):g} s {'ahead of' if ahead > 0 else 'behind'}" in fault.sentence
    np.testing.assert_allclose(log.groups["pose"].t, WEAVES, atol=1e-3)


def test_single_stamps_of_zero_are_left_out(tmp_path: Path) -> None:
    messages = weaving()
    name, written, _ = messages[30]
    messages[30] = (name, written, make.joints(-make.START, {"fl_wheel": 9.0, "fr_wheel": 9.0}))
    log = read_log(write(tmp_path, "mcap", messages))
    assert len(log.groups["wheels"].t) == len(WEAVES) - 1
    assert len(log.groups["pose"].t) == len(WEAVES)


def test_the_pose_is_that_of_the_most_independent_source(tmp_path: Path) -> None:
    """Neither the controller's, which follows from its wheels, nor a goal's."""
    log = read_log(write(tmp_path, "mcap", weaving(sources=("/tracker/pose",))))
    assert log.groups["pose"].source == "/tracker/pose"
    assert Inspected(log).faults == ()
    (why,) = [remark for remark in log.remarks if "the pose is that of" in remark]
    assert "/odom follows from the wheels alone" in why
    assert "/move_base/goal is a goal" in why
    alone = read_log(write(tmp_path, "mcap", weaving(sources=()), "alone"))
    assert alone.groups["pose"].source == "/odom"
    assert Inspected(alone).faults[0].kind == "circular"


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("front_left", "front_right"),
        ("wheel_FL_joint", "wheel_FR_joint"),
        ("left_wheel", "right_wheel"),
        ("rl", "rr"),
        ("motor_l", "motor_r"),
    ],
)
def test_joints_say_their_side_in_many_ways(tmp_path: Path, left: str, right: str) -> None:
    rates = {left: 2.0, right: 3.0, "caster_left_wheel": 99.0, "left_arm": 9.0}
    path = write(
        tmp_path, "mcap", [("/js", 0.1 * k, make.joints(0.1 * k, rates)) for k in range(9)]
    )
    columns = read_log(path).columns
    assert set(columns["enc_left"]) == {2.0}
    assert set(columns["enc_right"]) == {3.0}


@pytest.mark.parametrize("lost", ["nothing", "zeros", "NaN", "none"])
def test_efforts_of_a_sides_wheels_add_up_where_they_tell_something(
    tmp_path: Path, lost: str
) -> None:
    """Their sign is that of the axle. Drivers that know none leave zeros, NaN or no field."""
    rates = {"fl_wheel": 2.0, "rl_wheel": 4.0, "fr_wheel": -1.0, "rr_wheel": -1.0, "arm_left": 0.0}
    messages = list[Message]()
    for k in range(9):
        efforts = [1.0 + k, 3.0, -5.0, -6.0 - k, 99.0]
        if lost == "zeros":
            efforts = [0.0] * 5
        elif lost == "NaN":
            efforts[1] = math.nan
        made = make.joints(0.1 * k, rates, [] if lost == "none" else efforts)
        messages.append(("/js", 0.1 * k, made))
    columns = read_log(write(tmp_path, "mcap", messages)).columns
    assert set(columns["enc_left"]) == {3.0}
    if lost == "nothing":
        np.testing.assert_allclose(columns["torque_left"], 4.0 + np.arange(9))
        np.testing.assert_allclose(columns["torque_right"], -11.0 - np.arange(9))
    else:
        assert not {"torque_left", "torque_right"} & set(columns)


def test_joints_without_a_side_are_listed_and_can_be_named(tmp_path: Path) -> None:
    rates = {"m1": 1.0, "m2": 2.0, "m3": 3.0, "m4": 4.0}
    messages = [("/js", 0.1 * k, make.joints(0.1 * k, rates)) for k in range(9)]
    path = write(tmp_path, "mcap", [*messages, *poses_at(9)])
    (remark,) = [remark for remark in read_log(path).remarks if "'m1', 'm2'" in remark]
    assert "--columns enc_left=" in remark
    named = {"enc_left": ("m1+m3", ""), "enc_right": ("m2+m4", "")}
    columns = read_log(path, ReadOptions(columns=named)).columns
    assert set(columns["enc_left"]) == {2.0}
    assert set(columns["enc_right"]) == {3.0}


def test_transforms_are_chained_to_a_pose(tmp_path: Path) -> None:
    messages = list[Message]()
    for t in (0.1 * np.arange(40)).tolist():
        messages += [
            ("/tf", t, make.transform(t, "map", "odom", (1.0, 0.0, 0.5 * math.pi))),
            ("/tf", t, make.transform(t, "odom", "base_link", (t, 0.0, 0.0))),
        ]
    path = write(tmp_path, "mcap", messages)
    log = read_log(path)
    assert log.groups["pose"].source == "/tf:map.base_link"
    np.testing.assert_allclose(log.columns["y"], log.t, atol=ROUNDOFF)
    np.testing.assert_allclose(log.columns["x"], 1.0, atol=ROUNDOFF)
    named = read_log(path, ReadOptions(topics={"pose": "/tf:odom.base_link"}))
    np.testing.assert_allclose(named.columns["x"], named.t, atol=ROUNDOFF)


def test_what_is_no_bag_is_said_so(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    assert "no ROS 2 bag: there is no metadata.yaml in it" in refused(tmp_path / "folder")
    for name in ("text.bag", "text.mcap"):
        (tmp_path / name).write_text("hello, this is no bag at all")
        assert "no bag that can be read, or a damaged one" in refused(tmp_path / name)


# -------------------------------------------------------------------------------------------
# geometry
@given(
    st.floats(-80.0, 80.0),
    st.floats(-180.0, 180.0),
    st.floats(-300.0, 300.0),
    st.floats(-300.0, 300.0),
)
def test_local_metres_agree_with_the_ellipsoid(
    latitude: float, longitude: float, east: float, north: float
) -> None:
    """Against the chord between two points of WGS 84, which is the distance to 1e-9 there."""

    def cartesian(lat: float, lon: float) -> np.ndarray:
        a = 6378137.0
        f = 1.0 / 298.257223563
        e2 = f * (2.0 - f)
        phi = math.radians(lat)
        lam = math.radians(lon)
        n = a / math.sqrt(1.0 - e2 * math.sin(phi) ** 2)
        return np.array(
            [
                n * math.cos(phi) * math.cos(lam),
                n * math.cos(phi) * math.sin(lam),
                n * (1.0 - e2) * math.sin(phi),
            ]
        )

    there = (
        latitude + north / 111_000.0,
        longitude + east / (111_000.0 * math.cos(math.radians(latitude))),
    )
    x, y = to_local([latitude, there[0]], [longitude, there[1]])
    distance = float(np.linalg.norm(cartesian(*there) - cartesian(latitude, longitude)))
    # left out is the meridians' convergence, d^2 tan(latitude) / R: 0.16 m for 424 m at 80 degrees
    assert math.hypot(x[1], y[1]) == pytest.approx(
        distance, abs=1e-6 + 2.0 * distance**2 * 5.7 / 6.37e6
    )
    assert x[0] == y[0] == 0.0


def test_stamps_that_stand_still_are_no_clock(tmp_path: Path) -> None:
    """Times of writing count then, which is said; without these either nothing moves."""
    messages: list[Message] = []
    for k in range(40):
        messages += [
            ("/odom", 0.05 * k, make.odometry(0.0, (0.1 * k, 0.0, 0.0), 2.0, 0.0)),
            ("/joint_states", 0.05 * k, make.joints(0.0, {"left_wheel": 9.0, "right_wheel": 9.0})),
        ]
    log = read_log(write(tmp_path, "mcap", messages))
    np.testing.assert_allclose(log.groups["wheels"].t, 0.05 * np.arange(40), atol=1e-6)
    assert any("stand still, so the times of writing count" in remark for remark in log.remarks)
    at_once = [(name, 0.0, made) for name, _, made in messages]
    with pytest.raises(FileError, match="all messages have one and the same time"):
        read_log(write(tmp_path, "mcap", at_once, name="at_once"))
