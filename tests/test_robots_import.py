"""`import` finds a robot's numbers in a URDF of any names, order and frames, or refuses it."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.urdf_factory import UrdfRobot, extra_wheel
from validation import load_robot
from validation.descriptions.importing import RobotDraft, import_robot
from validation.robots import check_robot
from validation.simulator import foreign

DIGITS = 1e-6
"""Files of robots keep nine digits; a turned frame costs a few."""


def imported(robot: UrdfRobot, folder: Path) -> RobotDraft:
    path = folder / "robot.urdf"
    path.write_text(robot.text(), encoding="utf-8")
    return import_robot(path)


# with the digits of a file: MuJoCo's reader takes none below 2e-308
numbers = st.floats(0.0, 1.0).map(lambda number: round(number, 9))


@st.composite
def robots(draw: st.DrawFn) -> UrdfRobot:
    size = draw(st.floats(0.2, 3.0))
    radius = size * (0.05 + 0.15 * draw(numbers))
    wheelbase = 2.0 * radius + size * (0.05 + 0.4 * draw(numbers))
    width = size * (0.03 + 0.1 * draw(numbers))
    track = width + size * (0.2 + 0.4 * draw(numbers))
    # of matter that there is: others have another unit of mass
    mass = max(2000.0 * (wheelbase * track) ** 1.5 * (0.1 + draw(numbers)), 0.3)
    wheel = 0.05 * mass * (0.05 + draw(numbers))
    # so that the body fits into the robot
    share = 0.5 + 0.3 * np.array([draw(numbers), draw(numbers), draw(numbers)])
    box = share * np.array([wheelbase + 2.0 * radius, track, 1.2 * radius])
    spread = box**2 / 12.0
    inertia = mass * (spread.sum() - spread)
    away = 0.2 * box * np.array([draw(numbers) - 0.5, draw(numbers) - 0.5, draw(numbers) - 0.5])
    # names that lie, or say nothing
    names = draw(st.permutations(["w1", "wheel_b", "front_right_wheel", "rueda"]))
    flips = draw(st.lists(st.sampled_from([1.0, -1.0]), min_size=4, max_size=4))
    rolls = draw(
        st.lists(st.sampled_from([0.0, math.pi, 0.5 * math.pi, -0.7]), min_size=4, max_size=4)
    )
    axle = size * (draw(numbers) - 0.5) * 0.2
    return UrdfRobot(
        wheelbase,
        track,
        radius,
        width,
        axle,
        mass,
        (
            0.1 * wheelbase * draw(numbers),
            -0.1 * track * draw(numbers),
            axle + 0.3 * radius * draw(numbers),
        ),
        (float(inertia[0]), float(inertia[1]), float(inertia[2])),
        wheel,
        names,
        draw(st.permutations(range(4))),
        tuple((0.0, f * math.cos(r), -f * math.sin(r)) for f, r in zip(flips, rolls, strict=True)),
        rolls,
        lumps=(tuple(away), tuple(-away)),
    )


@given(made=robots())
def test_what_was_written_is_found(
    tmp_path_factory: pytest.TempPathFactory, made: UrdfRobot
) -> None:
    with pytest.MonkeyPatch.context() as here:  # another process for each would take a minute
        here.setattr(foreign, "try_compiling", lambda text, tolerant: (text, {}))
        robot = imported(made, tmp_path_factory.mktemp("urdf")).robot
    wanted = (made.wheelbase, made.track, made.radius, made.width, made.axle)
    np.testing.assert_allclose(
        [robot.wheelbase, robot.track, robot.wheel_radius, robot.wheel_width, robot.axle_height],
        wanted,
        rtol=DIGITS,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        [robot.mass, robot.wheel_mass], [made.mass + 4.0 * made.wheel, made.wheel], rtol=DIGITS
    )
    np.testing.assert_allclose(robot.com, made.com, rtol=DIGITS, atol=1e-7)
    np.testing.assert_allclose(robot.wheel_inertia, made.spin(), rtol=DIGITS)
    np.testing.assert_allclose(robot.inertia, made.inertia, rtol=1e-5)
    assert robot.source("geometry.wheelbase")[0] == "published"
    assert robot.source("drive.torque_limit")[0] == "assumed"


def test_the_file_is_one_that_checks_without_a_fault(tmp_path: Path) -> None:
    drafted = imported(UrdfRobot(), tmp_path)
    path = tmp_path / "mine.toml"
    path.write_text(drafted.text)
    assert load_robot(path) == drafted.robot
    assert check_robot(path).ok
    message = tomllib.loads(path.read_text())["sources"]
    assert message["geometry.link"].startswith("assumed: ")
    assert any("geometry.link" in remark for remark in drafted.remarks)


def test_rockers_are_no_wheels(tmp_path: Path) -> None:
    """As of a Warthog: revolute joints across the robot that carry the wheels."""
    text = UrdfRobot().text()
    for side, y in (("left", 0.3), ("right", -0.3)):
        rocker = extra_wheel(f"{side}_rocker", 0.0, y, kind="revolute")
        text = text.replace("</robot>", f"{rocker}</robot>")
        for end in ("front", "rear"):
            x = 0.25 if end == "front" else -0.25
            child = f'<child link="{end}_{side}"/>'
            origin = f'<origin xyz="{x} {y} 0.03" rpy="0.0 0 0"/>'
            text = text.replace(
                f'<parent link="base_link"/>{child}{origin}',
                f'<parent link="{side}_rocker"/>{child}<origin xyz="{x} 0 0"/>',
            )
    assert text.count('<parent link="left_rocker"/>') == 2
    (tmp_path / "rockers.urdf").write_text(text)
    robot = import_robot(tmp_path / "rockers.urdf").robot
    assert robot.wheelbase == pytest.approx(0.5)
    assert (
        "front_left_joint, front_right_joint, rear_left_joint, rear_right_joint"
        in robot.source("geometry.track")[1]
    )


def test_an_arm_and_a_lidar_are_lumped_into_the_body(tmp_path: Path) -> None:
    arm = extra_wheel("shoulder", 0.1, 0.0, axis="0 0 1", kind="revolute") + extra_wheel(
        "elbow", 0.1, 0.0, "shoulder", kind="revolute"
    )
    robot = imported(
        UrdfRobot(more=arm + extra_wheel("laser", 0.0, 0.0, axis="0 0 1")), tmp_path
    ).robot
    assert robot.mass == pytest.approx(40.0 + 8.0 + 3.0)
    x = (40.0 * 0.02 + 1.0 * 0.1 + 1.0 * 0.2) / 43.0
    assert robot.com[0] == pytest.approx(x)


def box(size: str, z: float) -> str:
    """Return a shape of collision on a link of the body."""
    geometry = (
        f'<collision><origin xyz="0 0 {z}"/><geometry><box size="{size}"/></geometry></collision>'
    )
    hinge = '<joint name="b" type="fixed"><parent link="base_link"/><child link="shape"/></joint>'
    return f'<link name="shape">{geometry}</link>{hinge}'


def test_an_antenna_is_no_hull(tmp_path: Path) -> None:
    """As of a Leo, whose hull is a mesh and whose antenna is a cylinder."""
    hull = imported(UrdfRobot(more=box("0.7 0.5 0.2", 0.1)), tmp_path).robot
    assert hull.body_size == pytest.approx((0.7, 0.5, 0.2))
    drafted = imported(UrdfRobot(more=box("0.02 0.02 0.4", 0.3)), tmp_path)
    assert drafted.robot.body_size[0] == pytest.approx(0.65)
    assert any("hull is estimated" in remark for remark in drafted.remarks)


ROS2 = (
    '<ros2_control name="r"><joint name="{{0}}_joint"><{}_interface name="velocity"/></joint>'
    "</ros2_control>"
)
MOTOR = {
    "transmission": '<transmission name="t{0}"><joint name="{0}_joint"/></transmission>',
    "ros2_control": ROS2.format("command"),
    "state only": ROS2.format("state"),
}


@pytest.mark.parametrize(
    ("kind", "count", "link"),
    [
        ("transmission", 4, "none"),
        ("ros2_control", 4, "none"),
        ("transmission", 2, "belt"),
        ("state only", 4, "belt"),
    ],
)
def test_four_motorised_wheels_are_four_motors(
    tmp_path: Path, kind: str, count: int, link: str
) -> None:
    """As of a Scout; a robot of which two wheels have motors has belts."""
    more = "".join(MOTOR[kind].format(name) for name in UrdfRobot().names[:count])
    robot = imported(UrdfRobot(more=more), tmp_path).robot
    assert robot.link == link
    assert robot.source("geometry.link")[0] == ("published" if link == "none" else "assumed")


WHEELS = UrdfRobot().text()
ON_BASE = '<parent link="base_link"/><child link="'
LOOP = '<joint name="l" type="fixed"><parent link="part0"/><child link="'
END = '"/></joint></robot>'
BOMB = '<!DOCTYPE b [<!ENTITY a "aaaa"><!ENTITY c "&a;&a;">]><robot name="&c;"/>'
REFUSED = {
    "six wheels": (
        UrdfRobot(more=extra_wheel("m1", 0, 0.3) + extra_wheel("m2", 0, -0.3)).text(),
        "it has 6 joints",
    ),
    "three wheels": (
        WHEELS.replace('rear_left_joint" type="continuous"', 'rear_left_joint" type="fixed"'),
        "has 3 joints",
    ),
    "steered": (
        WHEELS.replace(
            f"{ON_BASE}front_left", f"{ON_BASE.replace('base_link', 'knuckle')}front_left"
        ).replace(
            "</robot>", extra_wheel("knuckle", 0, 0, axis="0 0 1", kind="revolute") + "</robot>"
        ),
        "can be steered by joint 'knuckle_joint'",
    ),
    "tyres of meshes": (UrdfRobot(drums=False).text(), "give --wheel-radius and --wheel-width"),
    "no masses": (
        WHEELS.replace('<mass value="40.0"/>', '<mass value="0"/>'),
        "its body has no mass",
    ),
    "not XML": ("schema = 1", "this is no XML"),
    "xacro": (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/><xacro:a/></robot>',
        "expand it first",
    ),
    "left of xacro": (
        WHEELS.replace('<mass value="40.0"/>', '<mass value="${mass}"/>'),
        "expand it first",
    ),
    "a bomb": (BOMB, "declares a document type or entities"),
    "a loop": (WHEELS.replace("</robot>", f"{LOOP}base_link{END}"), "no tree"),
    "a number": (
        WHEELS.replace('<mass value="40.0"/>', '<mass value="heavy"/>'),
        "bad format in attribute 'value'",
    ),
    "twice": (WHEELS.replace('link name="part0"', 'link name="front_left"'), "repeated URDF name"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_such_robot_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    text, message = REFUSED[name]
    path = tmp_path / "r.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(message)) as refused:
        import_robot(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)
