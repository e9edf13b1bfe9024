"""Other people's MJCFs: diseases planted into a sound model are found by name, and cured."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Mapping
from ctypes.util import find_library
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from mujoco import MjData, MjModel, mj_step

from ssmr.control.loop import LoopSettings
from ssmr.control.references import line
from ssmr.geometry import quat_wxyz_to_yaw
from ssmr.types import CommandKind, Commands, FloatArray, State
from validation import cli, load_robot
from validation.descriptions import sdf
from validation.descriptions.balance import mechanical_turn, weigh_robot
from validation.descriptions.findings import static_findings
from validation.descriptions.foreign_robot import read_foreign
from validation.descriptions.importing import import_robot
from validation.descriptions.own_robot import OwnRobot
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.experiment.sources import RECORDING_GRID, commands_on_grid, driver_warnings
from validation.plants.profile import bare_profile, make_plant
from validation.robots import PROGRAM, check_robot, export_robot

OPTION = '<option cone="elliptic" impratio="100" timestep="0.004" integrator="implicitfast"/>'
SOFT = 'solimp="0.1 0.95 0.005 0.5 2" priority="1"'
WHEEL = (
    '<body name="{name}" pos="{x} {y} 0"><joint name="{name}_j" axis="{axis}" armature="0.05"/>\n'
    '<geom type="{shape}" size="{size}" pos="{at}" mass="2.5" friction="{mu} .005 .0001" {soft} '
    'condim="{condim}"/>'
    "</body>\n"
)
CORNERS = {
    "front_left": (1, 1),
    "front_right": (1, -1),
    "rear_left": (-1, 1),
    "rear_right": (-1, -1),
}
SOUND: Mapping[str, str] = {
    "option": OPTION,
    "soft": SOFT,
    "shape": "ellipsoid",
    "size": "0.15 0.04 0.15",
    "kv": "400",
    "force": "",
    "com": "0 0 0.05",
    "mu": "1",
    "condim": "3",
    "at": "0 0 0",
    "axis": "0 1 0",
    "ground": '<geom type="plane" size="20 20 .1"/>',
    "joint": "<freejoint/>",
    "more": "",
}


def model(odd: Mapping[str, str] | None = None, **changes: str) -> str:
    """Return the text of a sound cart with changes, and others of its first wheel."""
    n = {**SOUND, **changes}
    wheels = ""
    motors = ""
    for k, (name, (front, left)) in enumerate(CORNERS.items()):
        own = {**n, **(odd or {})} if k == 0 else n
        place = {"name": name, "x": 0.2 * front, "y": 0.25 * left}
        wheels += WHEEL.format(**{**own, **place})
        motors += f'<velocity joint="{name}_j" kv="{n["kv"]}" {n["force"]}/>\n'
    return (
        f'<mujoco model="cart"><!-- a -- b -->\n{n["option"]}\n<worldbody>{n["ground"]}'
        f'<body name="hull" pos="0 0 0.152">{n["joint"]}'
        f'<inertial pos="{n["com"]}" mass="30" diaginertia="0.4 0.9 1.2"/>\n{wheels}'
        f"</body></worldbody>\n<actuator>{motors}</actuator>{n['more']}</mujoco>"
    )


ROTOR = 'armature="0.05"'
DISEASES: Mapping[str, tuple[str, bool]] = {
    "unlike_wheels by friction": (model({"mu": "0.3"}), True),
    "which_friction": (model(condim="1"), True),
    "pyramid": (model(option=OPTION.replace("elliptic", "pyramidal")), True),
    "hopping": (model(soft=""), True),
    "hopping by a margin": (model(soft=SOFT + ' margin="0.03"'), True),
    "soft_on_one_geom": (model(soft=SOFT.replace('priority="1"', "")), True),
    "servo_soft": (model(kv="20"), True),
    "motor_weak": (model(force='forcerange="-6 6"'), True),
    "creep": (model(option=OPTION.replace('"100"', '"1"')), True),
    "rolls": (model(kv="40"), True),
    "step": (model(option=OPTION.replace("0.004", "0.01")), True),
    "unlike_wheels": (model({"size": "0.156 0.04 0.156"}), True),
    "wheel_shape": (model({"at": "0.01 0 0"}), True),
    "axes": (model({"axis": "0 -1 0"}), True),
    "weight_off": (model(com="-0.1 0 0.05"), False),
    "held by a tie": (
        model(more='<equality><joint joint1="front_left_j" joint2="front_right_j"/></equality>'),
        True,
    ),
    "held by its free joint": (model(joint='<joint type="free" damping="60"/>'), True),
    "held by dampers": (model().replace('armature="0.05"', 'armature="0.05" damping="40"'), True),
    "held by brakes": (
        model().replace('armature="0.05"', 'armature="0.05" frictionloss="90"'),
        True,
    ),
    "held by springs": (model().replace('armature="0.05"', 'armature="0.05" stiffness="30"'), True),
    "held by a liquid": (
        model(option=OPTION.replace("/>", ' density="1e3" viscosity="60"/>')),
        True,
    ),
    "which_friction by torsion": (model(condim="4").replace(" .005 ", " .3 "), True),
    "load": (model().replace('name="hull"', 'name="hull" gravcomp="0.9"'), True),
    "load by masks": (
        model().replace('size="20 20 .1"', 'size="20 20 .1" contype="2" conaffinity="2"'),
        True,
    ),
    "solver": (model(option=OPTION.replace("/>", ' solver="PGS" iterations="1"/>')), True),
    "effort": (model(force='ctrlrange="0 10"'), True),
    "inertia of rotors": (model().replace(ROTOR, 'armature="60"'), True),
    "axes by toe": (model({"axis": "0.05 1 0"}), True),
}
"""A model for each kind of finding, and whether the file that is written has it no more."""


Examined = tuple[Any, Path, Any]
"""Results of two checks: that of a model, the file that it wrote, and that of this file."""


@pytest.fixture(scope="module")
def examine(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Examined]:
    """Examines the model of a disease, once."""

    @cache
    def examined(kind: str) -> Examined:
        text, is_cured = DISEASES[kind]
        folder = tmp_path_factory.mktemp("theirs")
        path = folder / "theirs.xml"
        path.write_text(text)
        fixed = folder / "fixed.xml"
        check = check_robot(path, write=fixed if is_cured else None)
        assert path.read_text() == text
        return check, fixed, check_robot(fixed) if is_cured else None

    return examined


KINDS = [name.partition(" ")[0] for name in DISEASES]


@pytest.mark.parametrize(
    "kind",
    [
        # each kind by one cause, and in the slow tests by all; test_influences.py names each cause
        pytest.param(name, marks=[pytest.mark.slow] * (KINDS.index(KINDS[k]) < k))
        for k, name in enumerate(DISEASES)
    ],
)
def test_a_planted_disease_is_found_by_name_and_cured(
    kind: str, examine: Callable[[str], Examined]
) -> None:
    began = time.process_time()
    check, _, again = examine(kind)
    kind = kind.partition(" ")[0]
    assert kind in {finding.kind for finding in check.findings}
    if again is not None:
        assert kind not in {finding.kind for finding in again.findings}
        own = again.document()["own_physics"]
        assert own["multiplier"] == pytest.approx(own["closed_form"], rel=0.03)
    assert time.process_time() - began < 60.0
    json.dumps(check.as_dict(), allow_nan=False)


def test_a_sound_model_has_no_finding_and_turns_as_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "cart.xml"
    path.write_text(model())
    check = check_robot(path)
    assert not check.findings
    assert check.ok
    own = check.document()["own_physics"]
    assert own["multiplier"] == pytest.approx(1.0 + (0.4 / 0.5) ** 2, rel=0.01)
    assert sum(check.loads) == pytest.approx(40.0 * 9.81, rel=1e-3)
    rows = {row["row"]: row for row in check.document()["balance"]}
    moving = rows["mass to set off, wheels turning"]
    assert moving["found"] - moving["expected"] == pytest.approx(4.0 * 0.05 / 0.15**2, rel=1e-6)
    assert "armature" in moving["cause"]
    with pytest.raises(ValueError, match="nothing to write"):
        check_robot(path, write=tmp_path / "fixed.xml")
    assert not (tmp_path / "fixed.xml").exists()


def test_only_attributes_are_written(tmp_path: Path) -> None:
    """The comment with two dashes and every line stay as they are."""
    path = tmp_path / "theirs.xml"
    path.write_text(model(option=""))
    fixed = tmp_path / "fixed.xml"
    check_robot(path, write=fixed)
    before = path.read_text().splitlines()
    after = fixed.read_text().splitlines()
    assert len(after) == len(before)
    assert "<!-- a -- b -->" in after[0]
    same = [a == b for a, b in zip(before, after, strict=True)]
    assert sum(same) >= len(same) - 9


STOPPED = {
    "masks": (('size="20 20 .1"', 'size="20 20 .1" contype="2" conaffinity="2"'), "load"),
    "contacts off": (
        ("<worldbody>", '<option><flag contact="disable"/></option><worldbody>'),
        "held",
    ),
    "gravity up": (("timestep", 'gravity="0 0 9.81" timestep'), "load"),
    "actuation off": (
        ("<worldbody>", '<option><flag actuation="disable"/></option><worldbody>'),
        "held",
    ),
    "a tie": (
        (
            "</mujoco>",
            '<equality><joint joint1="front_left_j" joint2="rear_right_j"/></equality></mujoco>',
        ),
        "held",
    ),
}


@pytest.fixture(scope="module")
def faults_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], frozenset[str]]:
    """Returns the kinds of a model's faults, and examines it once."""

    @cache
    def kinds_of(text: str) -> frozenset[str]:
        path = tmp_path_factory.mktemp("theirs") / "theirs.xml"
        path.write_text(text)
        found = check_robot(path).findings
        return frozenset(finding.kind for finding in found if finding.severity == "fault")

    return kinds_of


@pytest.mark.parametrize(
    "name",
    # one that is carried otherwise and one that is held, and in the slow tests all
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name not in ("masks", "a tie")))
        for name in STOPPED
    ],
)
def test_of_a_robot_that_cannot_move_nothing_that_follows_is_blamed(
    name: str, faults_of: Callable[[str], frozenset[str]]
) -> None:
    """It has the faults of the same robot that can, and the one that keeps it from moving."""
    (old, new), kind = STOPPED[name]
    text = model(soft="", kv="40")
    assert faults_of(text)
    assert faults_of(text.replace(old, new)) == faults_of(text) | {kind}


@pytest.mark.parametrize("step", ["2e-6", pytest.param("1e-5", marks=pytest.mark.slow)])
def test_a_short_step_of_a_file_takes_no_longer(step: str, tmp_path: Path) -> None:
    """It is driven with a longer one, shows the same, and this is said."""
    kinds = []
    for each in ("1e-3", step):
        path = tmp_path / "theirs.xml"
        option = re.sub('timestep="[^"]*"', f'timestep="{each}"', OPTION)
        path.write_text(model(option=option.replace("elliptic", "pyramidal")))
        began = time.process_time()
        found = check_robot(path).findings
        kinds.append([finding.kind for finding in found])
        assert time.process_time() - began < 15.0
    assert kinds[1] == [*kinds[0], "step"]
    assert "times slower" in found[-1].cause


WEAK = 'forcerange="-20 20"'


def test_a_motor_is_raised_alone_and_no_maximum_is_lowered(tmp_path: Path) -> None:
    """Of four motors one is weak; the others give more than what would do."""
    path = tmp_path / "theirs.xml"
    path.write_text(model(force=WEAK).replace(WEAK, 'forcerange="-3 3"', 1))
    fixed = tmp_path / "fixed.xml"
    (finding,) = check_robot(path, write=fixed).findings
    assert finding.kind == "motor_weak"
    written = fixed.read_text()
    assert written.count(WEAK) == 3
    (raised,) = re.findall(r'forcerange="-\S+ (\S+)"', written.replace(WEAK, ""))
    assert float(raised) > 9.2


@pytest.mark.parametrize("kind", ["pyramid", "hopping", "servo_soft", "step"])
def test_what_is_written_is_printed_once_and_driven(
    kind: str, examine: Callable[[str], Examined]
) -> None:
    """Each attribute that differs stands in one change, and `after` is what the file does."""
    text = DISEASES[kind][0]
    check, fixed, again = examine(kind)
    findings = check.findings
    printed = " ".join(finding.change or "" for finding in findings)
    asked = re.findall(r'(\w+)="([^"]*)"', printed)
    written = fixed.read_text()
    for name, value in set(re.findall(r'(\w+)="([^"]*)"', written)):
        if f'{name}="{value}"' not in text:
            assert (name, value) in asked
    of_option = [pair for pair in asked if pair[0] in ("timestep", "impratio", "cone")]
    assert len({name for name, _ in of_option}) == len(set(of_option))
    rows = {row["row"]: row for row in again.document()["balance"]}
    for finding in findings:
        if finding.after is not None and finding.before is not None:
            row = next(rows[name] for name in rows if finding.before.startswith(name))
            assert finding.after.startswith(f"{row['found']:.3g} for {row['expected']:.3g}")


def test_a_residual_without_a_cause_is_a_fault_with_its_numbers(tmp_path: Path) -> None:
    """A belly that carries the robot is nothing that an attribute mends."""
    path = tmp_path / "theirs.xml"
    belly = (
        '<freejoint/><geom name="belly" type="box" size=".1 .1 .05" pos="0 0 -0.1013" mass="0"/>'
    )
    path.write_text(model(joint=belly))
    check = check_robot(path)
    found = [finding for finding in check.findings if finding.kind == "unexplained"]
    assert any("load" in finding.cause and "belly" in finding.cause for finding in found)
    assert not check.ok
    assert not any("wheel_separation_multiplier" in sentence for sentence in check.notes())


FRAMES: Mapping[str, Mapping[str, str]] = {
    "without ground": {"ground": ""},
    "without a free joint": {"joint": ""},
    "a keyframe of a scene": {"more": '<keyframe><key qpos="1 2 3"/></keyframe>'},
    "a mesh that is missing": {
        "more": '<asset><mesh name="m" file="no.stl"/></asset>',
        "joint": '<freejoint/><geom type="mesh" mesh="m" contype="0" conaffinity="0"/>',
    },
}


@pytest.mark.parametrize("name", FRAMES)
def test_what_simulators_read_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    path.write_text(model(**FRAMES[name]))
    check = check_robot(path)
    own = check.document()["own_physics"]
    assert own["multiplier"] == pytest.approx(1.64, rel=0.02)
    kinds = {finding.kind for finding in check.findings}
    assert kinds <= {"effort", "held"}
    assert ("held" in kinds) is (name == "without a free joint")


def test_parts_may_stand_in_other_files_and_pairs_may_name_a_floor_elsewhere(
    tmp_path: Path,
) -> None:
    unlike = 'friction="1 0.5 .005 .0001 .0001"'
    pairs = "".join(f'<pair geom1="{name}_g" geom2="floor" {unlike}/>' for name in CORNERS)
    text = model(ground="", more=f"<contact>{pairs}</contact>")
    for name in CORNERS:
        head, tail = text.split(f'<joint name="{name}_j"', 1)
        text = head + f'<joint name="{name}_j"' + tail.replace("<geom", f'<geom name="{name}_g"', 1)
    body = text[text.index("<worldbody>") : text.index("</worldbody>") + len("</worldbody>")]
    (tmp_path / "body.xml").write_text(f"<mujocoinclude>{body}</mujocoinclude>")
    path = tmp_path / "theirs.xml"
    path.write_text(text.replace(body, '<include file="body.xml"/>'))
    check = check_robot(path, write=tmp_path / "fixed.xml")
    assert "friction_by_heading" in {finding.kind for finding in check.findings}
    written = (tmp_path / "fixed.xml").read_text()
    assert "<include" not in written
    assert written.count('friction="1 1 0.005 0.0001 0.0001"') == 4
    assert "friction_by_heading" not in {
        f.kind for f in check_robot(tmp_path / "fixed.xml").findings
    }


def test_the_closed_form_holds_with_the_weight_off_the_middle(tmp_path: Path) -> None:
    robot = OwnRobot(model(com="0.05 -0.04 0.05"), {})
    weigh_robot(robot)
    turn = mechanical_turn(robot)
    assert robot.measures["multiplier"] == pytest.approx(turn.multiplier, rel=0.02)
    assert turn.multiplier != pytest.approx(1.64, rel=0.02)


def test_the_ground_may_begin_where_a_tyre_ends() -> None:
    """It is found, and none is added."""
    text = model(shape="cylinder", size="0.16 0.05").replace("0 0 0.152", "0 0 0.16")
    text = text.replace('type="cylinder"', 'type="cylinder" quat="0.7071 0.7071 0 0"')
    assert "0 0 0.16" in text
    assert not OwnRobot(text, {}).notes


def test_a_leaning_ground_is_not_weighed_as_a_level_one(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    path.write_text(model(ground='<geom type="plane" size="20 20 .1" euler="0 9 0"/>'))
    check = check_robot(path)
    assert check.ok
    assert "slope" in {finding.kind for finding in check.findings}


def test_it_may_drive_along_y(tmp_path: Path) -> None:
    """The body is turned by 90 degrees, and its names say which side is left."""
    text = model().replace(
        '<body name="hull" pos="0 0 0.152">', '<body name="hull" euler="0 0 90">'
    )
    robot = OwnRobot(text, {})
    assert robot.wheeled.names == [f"{name}_j" for name in CORNERS]
    weigh_robot(robot)
    assert robot.measures["multiplier"] == pytest.approx(1.64, rel=0.01)


def test_torque_motors_are_driven_by_rates_and_that_is_said(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    path.write_text(model().replace("<velocity", "<motor").replace('kv="400"', ""))
    check = check_robot(path)
    assert any("turn at given rates" in sentence for sentence in check.notes())
    assert check.document()["own_physics"]["droop"] < 0.05
    assert not check.findings


# ------------------------------------------------------------------------------------ as a plant
def test_another_robots_driver_before_a_description_is_said(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    path.write_text(model())
    (warning,) = driver_warnings(["mujoco", str(path)], load_robot("husky"))
    assert "its driver is that of husky" in warning
    assert not driver_warnings([str(path)], load_robot(path))


def test_a_controller_drives_a_description_of_others_as_it_drives_ours(tmp_path: Path) -> None:
    """Along a straight line of two metres, beside our own model of the same robot."""
    path = tmp_path / "theirs.xml"
    # a step of which the loops' periods are multiples
    path.write_text(model(option=OPTION.replace("0.004", "0.002")))
    profile = bare_profile(load_robot(path))
    law = make_controller(profile, load_gains("pid"))
    quiet = LoopSettings("truth", disturbance=False)
    ends = []
    for plant in (str(path), "mujoco"):
        robot = make_robot(profile, plant)
        (run,) = run_robots([robot], [law], [quiet], line(0.4, 2.0), [0])
        assert not run.lost
        ends.append(run.motion.xy[-1])
    np.testing.assert_allclose(ends[0], ends[1], atol=0.02)


def test_an_mjcf_is_a_plant_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    path.write_text(model())
    robot = load_robot(path)
    assert robot.wheelbase == pytest.approx(0.4)
    profile = bare_profile(robot)
    plant = make_plant(profile, str(path))
    commands = Commands(0.05, np.tile([0.3, 0.4], (80, 1)))
    start = State(x=1.0, y=-2.0, yaw=2.5)
    theirs = plant.run(commands, start, 0.05)
    np.testing.assert_allclose(theirs.pose[0], [1.0, -2.0, 2.5], atol=1e-6)
    ours = make_plant(profile, "mujoco").run(commands, start, 0.05)
    # both turn as mechanics says, however they set off
    np.testing.assert_allclose(theirs.twist[-1, ::2], ours.twist[-1, ::2], rtol=0.05)
    # stepwise as at once
    plant.reset(start)
    for v, w in commands.values:
        state = plant.step((v, w), commands.dt)
    np.testing.assert_allclose([state.x, state.y, state.yaw], theirs.pose[-1], atol=1e-4)


def test_given_rates_are_had_whatever_the_servos(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    path.write_text(model(kv="20"))
    profile = bare_profile(load_robot(path))
    rates = Commands(0.05, np.tile([1.0, 3.0], (60, 1)), "wheels")
    motion = make_plant(profile, str(path)).run(rates, State(), 0.05)
    np.testing.assert_allclose(motion.wheels[-1], [1.0, 3.0], rtol=2e-3)


def test_wheels_without_a_servo_are_no_soft_servos(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    text = model()
    for name in ("front_left", "front_right"):
        text = text.replace(f'<velocity joint="{name}_j" kv="400" />\n', "")
    path.write_text(text)
    found = {finding.kind: finding for finding in check_robot(path).findings}
    assert "servo_soft" not in found
    assert "front_left_j, front_right_j" in found["driven"].cause


def test_a_base_on_joints_of_a_plane_is_no_plant_and_it_is_said_why(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    slides = "".join(f'<joint name="{a}" type="slide" axis="{a}"/>' for a in ("1 0 0", "0 1 0"))
    path.write_text(model(joint=f'{slides}<joint name="turn" axis="0 0 1"/>'))
    with pytest.raises(ValueError, match=r"joints 1 0 0, 0 1 0, turn let it.*<freejoint/>"):
        make_plant(bare_profile(load_robot(path)), str(path))


def test_an_exported_robot_is_found_sound(tmp_path: Path) -> None:
    path = tmp_path / "husky.xml"
    path.write_text(export_robot("husky", "mjcf"))
    check = check_robot(path)
    assert check.ok
    own = check.document()["own_physics"]
    assert own["multiplier"] == pytest.approx(own["closed_form"], rel=0.01)


def test_a_heavy_thing_beside_the_robot_hides_no_wheels(tmp_path: Path) -> None:
    path = tmp_path / "theirs.xml"
    thing = '<body pos="3 0 1"><freejoint/><geom size="1" mass="500"/></body></worldbody>'
    path.write_text(model().replace("</worldbody>", thing))
    assert load_robot(path).mass == pytest.approx(40.0)


def test_hardly_any_inertia_raises_a_question(tmp_path: Path) -> None:
    path = tmp_path / "theirs.urdf"
    path.write_text(re.sub(r'i(xx|yy|zz)="[^"]*"', r'i\1="1e-6"', URDF))
    draft = import_robot(path)
    found = [f for f in static_findings(draft.robot, draft.foreign) if f.kind == "inertia"]
    assert [finding.severity for finding in found] == ["question"] * 2


# ----------------------------------------------------------------------------- its own logs
ROUND_TRIP_S = 6.0
SERVO = ("implicitfast", "400", 'type="ellipsoid" size="0.15 0.04 0.15"', "<velocity", "")
DRIVEN: Mapping[str, tuple[str, str, str, str, str]] = {
    "stiff": SERVO,
    "soft": ("Euler", "16", SERVO[2], "<velocity", ""),
    "cylinders": ("RK4", "20", 'type="cylinder" size="0.15 0.04" euler="90 0 0"', "<velocity", ""),
    "discrete": ("discrete", "100", SERVO[2], "<velocity", ""),
    "limited": (
        *SERVO[:4],
        '<default><velocity ctrlrange="-30 30" forcerange="-60 60"/></default>',
    ),
    "torques": ("implicitfast", "1", SERVO[2], "<motor", ""),
}
"""Integrator, feedback, tyres, actuators and defaults of carts."""


def steered(t: float) -> tuple[float, float]:
    """Return a speed [m/s] and a yaw rate [rad/s] without rest; an instant is in seconds."""
    v = 0.6 * np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t)
    return float(v), float(0.9 * np.sin(1.3 * t) + 0.4 * np.cos(0.5 * t) - 0.4)


def plain_log(text: str, kind: CommandKind, torques: bool) -> tuple[FloatArray, Commands]:
    """Return the poses (M, 3) of a log at 20 Hz that MuJoCo alone wrote, and its inputs.

    Commands are held from one row to the next; where the log is of wheel rates they change in each
    step, so that 20 Hz tell them all. With torques, a controller in the loop makes these.
    """
    robot = MjModel.from_xml_string(text)
    data = MjData(robot)
    dt = float(robot.opt.timestep)
    joints = [f"{name}_j" for name in CORNERS]
    dofs = [int(robot.joint(name).dofadr[0]) for name in joints]
    mj_step(robot, data, nstep=round(1.0 / dt))
    rows = []
    missed = np.zeros(4)
    for k in range(round(ROUND_TRIP_S / dt) + 1):
        row = k * dt / 0.05 + 1e-9
        is_row = row % 1.0 < 1e-6
        if is_row or kind == "wheels":
            v, w = steered(k * dt)
            rates = np.tile([(v - 0.25 * w) / 0.15, (v + 0.25 * w) / 0.15], 2)
        if is_row:
            x, y, _, *quat = data.qpos[:7].tolist()
            yaw = float(quat_wxyz_to_yaw(np.array(quat)))
            sides = data.qvel[dofs].reshape(2, 2).mean(axis=0)
            rows.append([x, y, yaw, *(sides if kind == "wheels" else (v, w))])
        error = rates - data.qvel[dofs]
        missed += error * dt
        data.ctrl = 30.0 * error + 300.0 * missed if torques else rates
        mj_step(robot, data)
    table = np.array(rows)
    stamps = 0.05 * np.arange(len(table))
    return table[:, :3], commands_on_grid(stamps, table[:, 3:], kind, RECORDING_GRID)


STEPS = ("0.001", "0.002", "0.005")


@pytest.mark.parametrize("kind", ["wheels", "twist"])
@pytest.mark.parametrize(
    ("name", "step"),
    [
        # each kind of cart has one step, and in the slow tests all
        pytest.param(name, step, marks=[pytest.mark.slow] * ((i + k) % 3 > 0))
        for i, name in enumerate(DRIVEN)
        for k, step in enumerate(STEPS)
    ],
)
def test_a_description_follows_the_log_that_plain_mujoco_wrote_of_it(
    name: str, step: str, kind: CommandKind, tmp_path: Path
) -> None:
    """Within a centimetre after six seconds; rates of 20 Hz tell a tenth of a changing one late."""
    integrator, feedback, tyre, motor, default = DRIVEN[name]
    torques = motor == "<motor"
    if torques and kind == "twist":
        pytest.skip("its controller is not in the file")
    option = OPTION.replace("0.004", step).replace("implicitfast", integrator)
    text = model(option=option, kv=feedback, mu="0.7").replace("<velocity", motor)
    text = text.replace(SERVO[2], tyre).replace("<worldbody>", f"{default}<worldbody>", 1)
    if torques:
        text = text.replace('kv="1"', "")
    path = tmp_path / "theirs.xml"
    path.write_text(text)
    poses, inputs = plain_log(text, kind, torques)
    plant = make_plant(bare_profile(load_robot(path)), str(path))
    motion = plant.run(inputs, State(*poses[0].tolist()), 0.05)
    off = motion.xy[-1] - poses[-1, :2]
    turned = motion.yaw[-1] - poses[-1, 2]
    assert np.hypot(*off) < 0.010
    assert abs(np.arctan2(np.sin(turned), np.cos(turned))) < 0.010


# ------------------------------------------------------------------------------------ other files
URDF_OF_ANOTHER = {
    "tracks": ('link name="base_link"', 'link name="left_track"', "tracks"),
    "mecanum": ('robot name="testcart"', 'robot name="mecanum_bot"', "mecanum"),
    "fixed": ('type="continuous"', 'type="fixed"', "fixed: make their joints continuous"),
    "about x": ('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/>', "turn about the x axis"),
    "xacro": ('value="30"', 'value="${mass}"', "xacro"),
    "limited": (
        'type="continuous"',
        'type="revolute"',
        "revolute, from -0.5 to 0.5 rad: make them continuous",
    ),
}
LINK = (
    '<link name="{0}"><collision><origin rpy="1.570796 0 0"/><geometry><cylinder radius=".15" '
    'length=".08"/></geometry></collision><inertial><mass value="2.5"/><inertia ixx=".0154" '
    'iyy=".028" izz=".0154"/></inertial></link>\n<joint name="{0}_joint" type="continuous">'
    '<parent link="base_link"/><child link="{0}"/><origin xyz="{1} {2} 0"/><axis xyz="0 1 0"/>'
    '<limit lower="-0.5" upper="0.5" effort="12" velocity="9"/></joint>\n'
)
URDF = (
    '<robot name="testcart"><!-- ${x} -- --><link name="base_link"><inertial><mass value="30"/>'
    '<inertia ixx=".4" iyy=".9" izz="1.2"/></inertial><collision><geometry><box size=".5 .36 .16"/>'
    "</geometry></collision></link>"
    + "".join(LINK.format(f"{n}_wheel", 0.2 * x, 0.25 * y) for n, (x, y) in CORNERS.items())
    + '<gazebo><gz:odd z:a="1"/></gazebo></robot>'
)


def test_a_urdf_is_read_as_tolerantly_as_simulators_do(tmp_path: Path) -> None:
    path = tmp_path / "a.urdf"
    path.write_text(URDF)
    robot = import_robot(path).robot
    assert robot.drive.torque_limit == pytest.approx(12.0)
    assert robot.drive.v_max == pytest.approx(9.0 * 0.15)
    assert robot.source("drive.torque_limit")[0] == "published"
    assert load_robot(path) == robot


@pytest.mark.parametrize("name", URDF_OF_ANOTHER)
def test_what_is_not_four_fixed_wheels_is_said_by_name(name: str, tmp_path: Path) -> None:
    old, new, words = URDF_OF_ANOTHER[name]
    path = tmp_path / "a.urdf"
    path.write_text(URDF.replace(old, new))
    with pytest.raises(ValueError, match=words):
        import_robot(path)


SPREAD = 'ixx=".4" iyy=".9" izz="1.2"'
SAME = "".join(
    f'<gazebo reference="{name}_wheel"><mu1 value="1"/><mu2 value="0.4"/></gazebo>'
    for name in CORNERS
)
URDF_DISEASES = {
    "negative inertia": (SPREAD, SPREAD.replace('".4"', '"-.4"'), {"inertia"}),
    "large products": (SPREAD, f'{SPREAD} ixy="2" ixz="2" iyz="2"', {"inertia"}),
    "no such inertia": (SPREAD, SPREAD.replace("1.2", "2.4"), {"inertia"}),
    "values as attributes": ("</robot>", f"{SAME}</robot>", {"friction_by_heading"}),
    "a cylinder that lies": ('rpy="1.570796 0 0"', 'rpy="0 0 0"', {"wheel_shape"}),
    "one larger wheel": ('radius=".15"', 'radius=".153"', {"unlike_wheels"}),
    "a box": (
        '<cylinder radius=".15" length=".08"/>',
        '<box size=".3 .3 .08"/>',
        {"wheel_shape"},
    ),
    "a lidar that turns": (
        "</robot>",
        '<link name="eye"><inertial><mass value=".1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4"/>'
        '</inertial></link><joint name="spin" type="continuous"><parent link="base_link"/><child '
        'link="eye"/><origin xyz="0 0 .3"/><axis xyz="0 1 0"/></joint></robot>',
        set(),
    ),
}


@pytest.mark.parametrize("name", URDF_DISEASES)
def test_what_is_wrong_with_a_urdf_is_a_finding(name: str, tmp_path: Path) -> None:
    old, new, kinds = URDF_DISEASES[name]
    path = tmp_path / "a.urdf"
    path.write_text(URDF.replace(old, new, 1))
    draft = import_robot(path)
    assert kinds == {finding.kind for finding in static_findings(draft.robot, draft.foreign)}


def test_wheels_of_any_name_are_named_where_they_do_not_turn(tmp_path: Path) -> None:
    path = tmp_path / "a.urdf"
    text = URDF.replace("_wheel", "").replace("_joint", "").replace("continuous", "revolute")
    path.write_text(text)
    with pytest.raises(ValueError, match=r"front_left, .*: revolute, from -0\.5 to 0\.5 rad"):
        import_robot(path)


SDF_LINK = (
    '<link name="{0}"><pose relative_to="chassis">{1} {2} 0 0 0 0</pose><inertial><mass>2.5</mass>'
    "<inertia><ixx>.0154</ixx><iyy>.028</iyy><izz>.0154</izz></inertia></inertial>"
    '<collision name="c"><pose>0 0 0 1.5707963 0 0</pose><geometry><cylinder><radius>.15</radius>'
    "<length>.08</length></cylinder></geometry><surface><friction><ode><mu>0.8</mu><mu2>0.8</mu2>"
    '</ode></friction></surface></collision></link><joint name="{0}_joint" type="revolute"><parent>'
    "chassis</parent><child>{0}</child><axis><xyz>0 1 0</xyz></axis></joint>"
)


def test_each_frame_of_an_sdf_is_placed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where many are given in each other: a chain took the square of its length."""
    poses: list[Any] = []
    place = sdf._pose
    monkeypatch.setattr(sdf, "_pose", lambda pose: poses.append(pose) or place(pose))
    count = 90
    chain = "".join(
        f'<frame name="f{k}"><pose relative_to="f{k + 1}">1 0 0 0 0 0</pose></frame>'
        for k in range(count)
    )
    model = ElementTree.fromstring(f'<model>{chain}<frame name="f{count}"/></model>')
    frames = sdf._Frames(model)
    ends = [frames.of(f"f{k}")[0, 3] for k in range(count)]
    assert ends == [float(count - k) for k in range(count)]
    assert len(poses) == count + 1


def test_an_sdf_is_a_robot_with_friction_and_controller(tmp_path: Path) -> None:
    wheels = "".join(SDF_LINK.format(f"{n}_w", 0.2 * x, 0.25 * y) for n, (x, y) in CORNERS.items())
    path = tmp_path / "a.sdf"
    path.write_text(
        '<sdf version="1.9"><world name="w"><model name="cart"><link name="chassis"><pose>1 2 .15 '
        "0 0 0.7</pose><inertial><pose>0 0 .05 0 0 0</pose><mass>30</mass><inertia><ixx>.4</ixx>"
        f"<iyy>.9</iyy><izz>1.2</izz></inertia></inertial></link>{wheels}"
        '<plugin name="p" filename="gz-sim-diff-drive-system"><wheel_separation>0.5'
        "</wheel_separation><wheel_radius>0.15</wheel_radius></plugin></model></world></sdf>"
    )
    draft = import_robot(path)
    robot = draft.robot
    assert robot.wheelbase == pytest.approx(0.4)
    assert robot.track == pytest.approx(0.5)
    assert robot.friction == pytest.approx(0.8)
    assert robot.com == pytest.approx((0.0, 0.0, 0.05))
    assert robot.drive.command_half_track == pytest.approx(0.25)
    kinds = {finding.kind for finding in static_findings(robot, draft.foreign)}
    assert kinds == {"controller"}
    yaml = tmp_path / "diff_drive.yaml"
    yaml.write_text("a:\n  wheel_separation: 0.5\n  wheel_separation_multiplier: 1.64\n")
    draft = import_robot(path, controller=yaml)
    assert draft.robot.drive.command_half_track == pytest.approx(0.41)
    assert not static_findings(draft.robot, draft.foreign)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("<include><uri>model://lidar</uri></include>", "includes model://lidar"),
        ('<model name="mast"><link name="pole"/></model>', "holds the model 'mast'"),
    ],
)
def test_what_an_sdf_takes_from_elsewhere_is_not_left_out(
    more: str, message: str, tmp_path: Path
) -> None:
    wheels = "".join(SDF_LINK.format(f"{n}_w", 0.2 * x, 0.25 * y) for n, (x, y) in CORNERS.items())
    path = tmp_path / "a.sdf"
    model = f'<model name="cart"><link name="chassis"/>{wheels}{more}</model>'
    path.write_text(f'<sdf version="1.9">{model}</sdf>')
    with pytest.raises(ValueError, match=message):
        import_robot(path)


def test_the_kinematic_plant_turns_about_where_the_weight_says(tmp_path: Path) -> None:
    path = tmp_path / "a.urdf"
    for origin in ("-0.125 0 0", "0.05 -0.06 0"):
        text = URDF.replace("<inertial>", f'<inertial><origin xyz="{origin}"/>', 1)
        path.write_text(text)
        profile = bare_profile(load_robot(path))
        commands = Commands(0.05, np.tile([0.2, 0.5], (160, 1)))
        theirs = make_plant(profile, "mujoco").run(commands, State(), 0.05)
        ours = make_plant(profile, "kinematic").run(commands, State(), 0.05)
        assert theirs.twist[-1, 2] == pytest.approx(ours.twist[-1, 2], rel=0.06)
        assert theirs.twist[-1, 1] == pytest.approx(ours.twist[-1, 1], abs=0.01)


def test_a_mistake_ends_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.urdf"
    path.write_text(URDF)
    for arguments in (
        ("check", str(path), "--write", str(tmp_path / "x.xml")),
        ("check", "husky", "--controller", str(path)),
        ("check", str(path), "--controller", str(path)),
    ):
        with pytest.raises(SystemExit) as left:
            cli.run_command(PROGRAM, "robots", (*arguments, "--out", str(tmp_path / "out")))
        assert left.value.code == cli.EXIT_USER_ERROR
        assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "x.xml").exists()
    assert read_foreign(path).kind == "urdf"


@pytest.mark.skipif(find_library("ode") is None, reason="ODE is not installed")
def test_gazebos_friction_is_tried_in_ode_against_a_cone(tmp_path: Path) -> None:
    contact = "<mu1>0.8</mu1><mu2>0.4</mu2><fdir1>1 0 0</fdir1>"
    wheels = "".join(f'<gazebo reference="{name}_wheel">{contact}</gazebo>' for name in CORNERS)
    path = tmp_path / "a.urdf"
    path.write_text(URDF.replace("</robot>", f"{wheels}</robot>"))
    check = check_robot(path, engine="ode")
    (finding,) = [f for f in check.findings if f.kind == "friction_by_heading"]
    assert finding.before is not None
    assert finding.after is not None
    assert "turning ratio 1.6" in finding.after
    assert "turning ratio 1.6" not in finding.before
    theirs = tmp_path / "theirs.xml"
    theirs.write_text(model())
    with pytest.raises(ValueError, match="engine that it is of"):
        check_robot(theirs, engine="ode")
