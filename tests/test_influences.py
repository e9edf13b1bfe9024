"""What stops, slows or turns a robot is read off its file, and sound robots have none of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from validation.descriptions.findings import Finding, static_findings
from validation.descriptions.importing import import_robot
from validation.robots import check_robot

CORNERS = {"fl": (1, 1), "fr": (1, -1), "rl": (-1, 1), "rr": (-1, -1)}
MJCF_WHEEL = """
<body name="k_{n}" pos="{x} {y} 0">{slide}<body name="w_{n}">
 <joint name="{n}" axis="0 1 0" armature="{armature}" JOINT/>
 <geom name="t_{n}" type="ellipsoid" size="{r} {w} {r}" mass="{m}" friction="0.7 .005 .0001"
  solimp="0.1 0.95 {depth} 0.5 2" priority="1" TYRE/></body></body>"""
SLIDE = """<joint type="slide" axis="0 0 1" stiffness="{stiff}" damping="{damp}"/>
<inertial pos="0 0 0" mass="{light}" diaginertia="{spin} {spin} {spin}"/>"""
PLANE = '<geom name="floor" type="plane" size="90 90 1" GROUND/>'
URDF_WHEEL = """<link name="w_{n}"><inertial><origin xyz="OFF"/><mass value="{m}"/>
<inertia ixx="{ixx}" iyy="{iyy}" izz="{ixx}"/></inertial><collision><origin rpy="1.5707963 0 0"/>
<geometry><cylinder radius="{r}" length="{width}"/></geometry></collision></link>
<joint name="{n}" type="continuous"><parent link="base"/><child link="w_{n}"/>
<origin xyz="{x} {y} 0"/><axis xyz="0 1 0"/><limit effort="{effort}" velocity="20"/>
<dynamics damping="0"/></joint><gazebo reference="w_{n}"><mu1>0.7</mu1><mu2>0.7</mu2><kp>{kp}</kp>
</gazebo>
"""
PLUGIN = """<plugin name="d" filename="gz-sim-diff-drive-system"><left_joint>fl</left_joint>
<left_joint>rl</left_joint><right_joint>fr</right_joint><right_joint>rr</right_joint></plugin>"""
SDF_WHEEL = """<link name="w_{n}"><pose>{x} {y} {r} 0 0 0</pose><inertial><mass>{m}</mass><inertia>
<ixx>{ixx}</ixx><iyy>{iyy}</iyy><izz>{ixx}</izz></inertia></inertial><collision name="c">
<pose>0 0 0 1.5707963 0 0</pose><geometry><cylinder><radius>{r}</radius><length>{width}</length>
</cylinder></geometry><surface><friction><ode><mu>0.7</mu><mu2>0.7</mu2></ode></friction><contact>
<ode><kp>{kp}</kp></ode></contact></surface></collision></link>
<joint name="{n}" type="revolute"><parent>base</parent><child>w_{n}</child><axis><xyz>0 1 0</xyz>
<limit><effort>{effort}</effort></limit><dynamics><damping>0</damping></dynamics></axis></joint>
"""


def sizes(scale: float) -> Mapping[str, float]:
    """Return numbers of a sound cart that is `scale` times as large, and of the same stuff."""
    return {
        "r": 0.13 * scale,
        "w": 0.04 * scale,
        "width": 0.08 * scale,
        "depth": 0.004 * scale,
        "m": 1.5 * scale**3,
        "light": 0.2 * scale**3,
        "mass": 24.0 * scale**3,
        "a": 0.31 * scale**5,
        "b": 0.75 * scale**5,
        "c": 0.95 * scale**5,
        "ixx": 0.0072 * scale**5,
        "iyy": 0.0127 * scale**5,
        "spin": 1e-3 * scale**5,
        "armature": 0.05 * scale**5,
        "effort": 30.0 * scale**4,
        "kv": 150.0 * scale**4.5,
        "kp": 1e5 * scale**2,
        "stiff": 6e3 * scale**2,
        "damp": 250.0 * scale**2.5,
        "up": 0.05 * scale,
        "ahead": 0.3 * scale,
        "aside": 0.17 * scale,
        "high": 0.06 * scale,
        "tall": 0.12 * scale,
        "long": 0.6 * scale,
        "broad": 0.34 * scale,
        "step": 0.002 * scale**0.5,
    }


def text_of(kind: str, scale: float = 1.0, slide: str = "", ground: str = PLANE) -> str:
    """Return a sound cart as a URDF, an SDF or an MJCF."""
    n = sizes(scale)
    pattern = {"urdf": URDF_WHEEL, "sdf": SDF_WHEEL, "xml": MJCF_WHEEL}[kind]
    wheels = ""
    for name, (front, left) in CORNERS.items():
        place = {"n": name, "x": 0.2 * scale * front, "y": 0.24 * scale * left}
        wheels += pattern.format(**n, **place, slide=slide.format(**n))
    if kind == "urdf":
        body = (
            '<link name="base"><inertial><origin xyz="0 0 {up}"/><mass value="{mass}"/><inertia '
            'ixx="{a}" iyy="{b}" izz="{c}"/></inertial><collision><origin xyz="0 0 {up}"/>'
            '<geometry><box size="{long} {broad} {tall}"/></geometry></collision></link>'
        )
        plugin = f"<gazebo>{PLUGIN}</gazebo>"
        wheels = wheels.replace("OFF", "0 0 0")
        return f'<robot name="cart">{body.format(**n)}{wheels}{plugin}</robot>'
    if kind == "sdf":
        body = (
            '<link name="base"><pose>0 0 {r} 0 0 0</pose><inertial><pose>0 0 {up} 0 0 0</pose>'
            "<mass>{mass}</mass><inertia><ixx>{a}</ixx><iyy>{b}</iyy><izz>{c}</izz></inertia>"
            '</inertial><collision name="c"><pose>0 0 {up} 0 0 0</pose><geometry><box><size>{long} '
            "{broad} {tall}</size></box></geometry></collision></link>"
        )
        parts = body.format(**n) + wheels + PLUGIN
        return f'<sdf version="1.7"><model name="cart">{parts}</model></sdf>'
    motors = "".join(f'<velocity name="m_{k}" joint="{k}" kv="{n["kv"]}" MOTOR/>' for k in CORNERS)
    body = (
        '<body name="base" pos="0 0 {r}" YAW><freejoint name="root"/><geom type="box" '
        'size="{ahead} {aside} {high}" pos="0 0 {up}" mass="{mass}"/>'
    )
    option = f'<option timestep="{n["step"]}" integrator="implicitfast" cone="elliptic" OPTION/>'
    return (
        f'<mujoco model="cart"><compiler angle="radian" autolimits="true"/>{option}HFIELD'
        f"<worldbody>{ground}{body.format(**n)}{wheels}</body></worldbody><actuator>{motors}"
        "</actuator>MORE</mujoco>"
    )


BLANKS = ("JOINT", "TYRE", "GROUND", "MOTOR", "OPTION", "MORE", "YAW", "HFIELD")


def findings_of(folder: Path, kind: str, text: str) -> list[Finding]:
    """Return what a description's numbers say."""
    for blank in BLANKS:
        text = text.replace(blank, "")
    path = folder / f"a.{kind}"
    path.write_text(text)
    draft = import_robot(path)
    return static_findings(draft.robot, draft.foreign)


GROUNDS = {
    "none": "",
    "a small box": '<geom type="box" size="0.9 0.9 0.1" pos="0 0 -0.1"/>',
    "a height field over a plane": '<geom type="plane" size="9 9 1" pos="0 0 -1" contype="0" '
    'conaffinity="0"/><geom type="hfield" hfield="h"/>',
    "ice": PLANE.replace("GROUND", 'friction="0.7"'),
}
FIELD = (
    '<asset><hfield name="h" nrow="3" ncol="3" size="9 9 1 1" elevation="0 0 0 0 0 0 0 0 0"/>'
    "</asset>"
)


@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("kind", ["urdf", "sdf", "xml"])
def test_a_sound_robot_of_any_size_is_sound(kind: str, scale: float, tmp_path: Path) -> None:
    assert not findings_of(tmp_path, kind, text_of(kind, scale))


@pytest.mark.parametrize("yaw", [0.5, 1.6, 3.14, -2.0])
@pytest.mark.parametrize("slide", ["", SLIDE])
def test_a_sound_robot_starts_at_any_heading(yaw: float, slide: str, tmp_path: Path) -> None:
    text = text_of("xml", slide=slide).replace("YAW", f'euler="0 0 {yaw}"')
    assert not findings_of(tmp_path, "xml", text)


PAIRS = "".join(f'<pair geom1="t_{n}" geom2="floor" condim="3"/>' for n in CORNERS)
BELT = '<equality><joint joint1="fl" joint2="rl"/><joint joint1="fr" joint2="rr"/></equality>'
HARMLESS = {
    "pairs alone": {"TYRE": 'contype="0" conaffinity="0"', "MORE": f"<contact>{PAIRS}</contact>"},
    "belts": {"MORE": BELT},
    "gears that make up for axes": {
        '"fl" axis="0 1 0"': '"fl" axis="0 -1 0"',
        'joint="fl" kv="150.0"': 'joint="fl" kv="150.0" gear="-1"',
    },
    "a little damping": {"JOINT": 'damping="0.5" frictionloss="0.2"'},
    "the moon": {"OPTION": 'gravity="0 0 -1.6"'},
    "air": {"OPTION": 'density="1.2" viscosity="1.8e-5"'},
}


@pytest.mark.parametrize("name", HARMLESS)
def test_what_takes_nothing_of_a_turn_is_no_finding(name: str, tmp_path: Path) -> None:
    text = text_of("xml")
    for old, new in HARMLESS[name].items():
        assert old in text
        text = text.replace(old, new)
    assert not findings_of(tmp_path, "xml", text)


@pytest.mark.parametrize("ground", GROUNDS)
def test_a_sound_robot_stands_on_any_ground(ground: str, tmp_path: Path) -> None:
    text = text_of("xml", ground=GROUNDS[ground])
    if "hfield" in text:
        text = text.replace("HFIELD", FIELD)
    assert not findings_of(tmp_path, "xml", text)


LEFT_RIGHT = "<left_joint>fl</left_joint>"
Disease = tuple[str, str, str, str, str]
DISEASES: Mapping[str, Disease] = {
    "damped axles": ("urdf", 'damping="0"', 'damping="60"', "held", "damping"),
    "damped axles, SDF": ("sdf", "<damping>0", "<damping>60", "held", "damping"),
    "damped joints": ("xml", "JOINT", 'damping="40"', "held", "damping"),
    "dry axles": ("urdf", 'damping="0"', 'friction="28"', "held", "friction"),
    "dry joints": ("xml", "JOINT", 'frictionloss="200"', "held", "frictionloss"),
    "springs": ("xml", "JOINT", 'stiffness="90"', "held", "spring"),
    "range": ("urdf", 'type="continuous"', 'type="revolute"', "held", "0..0"),
    "static": ("sdf", '"cart">', '"cart"><static>true</static>', "held", "static"),
    "kinematic": ("sdf", "</inertial>", "</inertial><kinematic>1</kinematic>", "held", "kinem"),
    "no gravity": ("sdf", "</inertial>", "</inertial><gravity>0</gravity>", "load", "gravity"),
    "turned off": ("urdf", "<mu1>", "<turnGravityOff>true</turnGravityOff><mu1>", "load", "grav"),
    "gravcomp": ("xml", "YAW", 'gravcomp="0.9"', "load", "gravcomp"),
    "honey": ("xml", "OPTION", 'density="1000" viscosity="5"', "held", "liquid"),
    "water": ("xml", "OPTION", 'density="1000" viscosity="0.001"', "held", "liquid"),
    "flags": ("xml", "MORE", '<option><flag contact="disable"/></option>', "load", "contype"),
    "floating": ("xml", "MORE", '<option><flag gravity="disable"/></option>', "load", "gravcomp"),
    "upward": ("xml", "OPTION", 'gravity="0 0 9.81"', "load", "gravcomp"),
    "off": ("xml", "MORE", '<option><flag actuation="disable"/></option>', "motor_weak", "0 N m"),
    "masks": ("xml", "GROUND", 'contype="2" conaffinity="2"', "load", "contype"),
    "excluded": (
        "xml",
        "MORE",
        '<contact><exclude body1="world" body2="w_fl"/></contact>',
        "load",
        "exclude",
    ),
    "mu 0": ("sdf", "<mu>0.7</mu><mu2>0.7", "<mu>0</mu><mu2>0", "which_friction", "friction of 0"),
    "condim 1": ("xml", "TYRE", 'condim="1"', "which_friction", "condim"),
    "rolling": (
        "xml",
        'friction="0.7 .005 .0001"',
        'friction="0.7 .005 .9" condim="6"',
        "which_friction",
        "rolling",
    ),
    "slip": ("urdf", "<mu1>", "<slip1>1</slip1><mu1>", "which_friction", "slip"),
    "soft ground": ("urdf", "<kp>100000.0", "<kp>500", "load", "sink"),
    "two frictions": ("urdf", "<mu2>0.7", "<mu2>0.4", "friction_by_heading", "mu2"),
    "a larger one wins": (
        "xml",
        'solimp="0.1 0.95 0.004 0.5 2" priority="1"',
        "",
        "which_friction",
        "larger",
    ),
    "a larger one is first": (
        "xml",
        "GROUND",
        'friction="2 .005 .0001" priority="2"',
        "which_friction",
        "larger",
    ),
    "leaning ground": ("xml", "GROUND", 'euler="0 0.16 0"', "slope", "the ground leans"),
    "leaning gravity": ("xml", "OPTION", 'gravity="2 0 -9.6"', "load", "leans"),
    "no torque": ("urdf", 'effort="30.0"', 'effort="0"', "effort", "effort"),
    "no speed": ("urdf", 'velocity="20"', 'velocity="0"', "effort", "velocity"),
    "weak": ("sdf", "<effort>30.0", "<effort>2", "motor_weak", "2 N m"),
    "weak plugin": ("urdf", "</plugin>", "<torque>2</torque></plugin>", "motor_weak", "torque"),
    "weak motors": ("xml", "MOTOR", 'forcerange="-3 3"', "motor_weak", "3 N m"),
    "one way": ("xml", "MOTOR", 'ctrlrange="0 10"', "effort", "ctrlrange"),
    "swapped": (
        "urdf",
        PLUGIN,
        PLUGIN.replace("left", "L").replace("right", "left").replace("L_", "right_"),
        "controller",
        "swapped",
    ),
    "half": ("sdf", "<left_joint>rl</left_joint>", "", "controller", "rl only roll"),
    "not there": ("urdf", LEFT_RIGHT, "<left_joint>arm</left_joint>", "controller", "arm"),
}
"""Kind of file, what is written otherwise, kind of the finding, and words that it has."""
FIRST: Mapping[str, Disease] = {
    "gear": ("xml", "MOTOR", 'gear="-1"', "axes", "gear"),
    "gain": ("xml", 'kv="150.0"', 'kv="75"', "effort", "kv"),
    "motor of another": ("xml", 'name="m_fl"', 'name="m_fr_x"', "names", "motors"),
    "weak motor": ("xml", "MOTOR", 'forcerange="-3 3"', "motor_weak", "of fl"),
    "high axle": ("urdf", "0.24 0", "0.24 0.01", "unlike_wheels", "three wheels"),
    "toe": ("urdf", '<axis xyz="0 1 0"/>', '<axis xyz="0.06 1 0"/>', "axes", "parallel"),
    "off centre": ("urdf", 'xyz="0 0 0"', 'xyz="0 0 0.03"', "mass_in_wheels", "beside the axle"),
    "bald": ("sdf", "<mu>0.7</mu><mu2>0.7", "<mu>0.3</mu><mu2>0.3", "unlike_wheels", "friction"),
    "large": ("urdf", 'radius="0.13"', 'radius="0.135"', "unlike_wheels", "radius"),
}
"""The same of one wheel alone."""


@pytest.mark.parametrize("name", [*DISEASES, *FIRST])
def test_whatever_stops_slows_or_turns_a_robot_is_named(name: str, tmp_path: Path) -> None:
    kind, old, new, wanted, words = {**DISEASES, **FIRST}[name]
    text = text_of(kind)
    assert old in text
    found = findings_of(tmp_path, kind, text.replace(old, new, 1 if name in FIRST else -1))
    causes = [finding.cause for finding in found if finding.kind == wanted]
    assert any(words in cause for cause in causes), found
    # nothing else is blamed
    assert {finding.kind for finding in found} <= {wanted, "effort", "inertia"}, found


def text_in_units(kind: str, per_metre: float) -> str:
    """Return a sound cart whose lengths are in another unit, but not its masses."""
    text = text_of(kind, per_metre)
    for mass in ("24", "1.5"):
        text = text.replace(repr(float(mass) * per_metre**3), mass)
    return text


def in_grams(kind: str) -> str:
    """Return a sound cart whose masses are in grams, but not its inertia."""
    return re.sub(
        r"""(mass(?: value)?=?["'>])([\d.]+)""",
        lambda match: match[1] + repr(1e3 * float(match[2])),
        text_of(kind),
    )


STATUE = text_of("urdf").replace('type="continuous"', 'type="fixed"')
REFUSED = {
    "a statue": ("urdf", STATUE, "statue"),
    "millimetres": ("urdf", text_in_units("urdf", 1000.0), "millimetres"),
    "centimetres": ("sdf", text_in_units("sdf", 100.0), "centimetres"),
    "grams": ("urdf", in_grams("urdf"), "in grams"),
    "grams, SDF": ("sdf", in_grams("sdf"), "in grams"),
    "grams, MJCF": ("xml", in_grams("xml"), "in grams"),
    "a car": (
        "xml",
        text_of("xml").replace('<joint name="f', '<joint axis="0 0 1"/><joint name="f'),
        "can be steered",
    ),
    "a base in the world": (
        "xml",
        text_of("xml")
        .replace("<body name", "<frame name", 1)
        .replace("</body></worldbody>", "</frame></worldbody>")
        .replace('<freejoint name="root"/>', ""),
        "freejoint",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_robot_that_drives_is_refused_by_name(name: str, tmp_path: Path) -> None:
    kind, text, words = REFUSED[name]
    with pytest.raises(ValueError, match=words):
        findings_of(tmp_path, kind, text)


ANGLES: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "rpy": ("urdf", {"1.5707963": "ANGLE"}),
    "rpy of the joints": (
        "urdf",
        {
            '1.5707963 0 0"/>\n<geo': '0 0 0"/>\n<geo',
            ' 0"/><axis xyz="0 1 0"': ' 0" rpy="ANGLE 0 0"/><axis xyz="0 0 -1"',
        },
    ),
    "rpy of joints with meshes": (
        "urdf",
        {
            '<cylinder radius="0.13" length="0.08"/>': '<mesh filename="wheel.stl"/>',
            ' 0"/><axis xyz="0 1 0"': ' 0" rpy="ANGLE 0 0"/><axis xyz="0 0 -1"',
        },
    ),
    "poses": ("sdf", {"1.5707963": "ANGLE"}),
    "euler of shapes": (
        "xml",
        {'"ellipsoid" size="0.13 0.04 0.13"': '"cylinder" size="0.13 0.04" euler="ANGLE 0 0"'},
    ),
    "euler of wheels": (
        "xml",
        {
            '<body name="w_': '<body euler="ANGLE 0 0" name="w_',
            'axis="0 1 0"': 'axis="0 0 -1"',
            "0.13 0.04 0.13": "0.13 0.13 0.04",
        },
    ),
}


@pytest.mark.parametrize("name", ANGLES)
def test_angles_in_the_other_unit_are_said_by_name(name: str, tmp_path: Path) -> None:
    kind, changes = ANGLES[name]
    text = text_of(kind)
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    if "mesh" not in text:
        assert not findings_of(tmp_path, kind, text.replace("ANGLE", "1.5707963"))
    degrees = text.replace("ANGLE", "90")
    with pytest.raises(ValueError, match=r"other unit.* radians"):
        findings_of(tmp_path, kind, degrees)
    if kind == "xml":
        assert not findings_of(tmp_path, kind, degrees.replace('"radian"', '"degree"'))
        other = text.replace("ANGLE", "1.5707963").replace('"radian"', '"degree"')
        with pytest.raises(ValueError, match="other <compiler angle>"):
            findings_of(tmp_path, kind, other)


@pytest.mark.parametrize("kind", ["urdf", "sdf"])
@pytest.mark.parametrize(
    ("unit", "per_unit"), [("kg cm2", 1e4), ("kg mm2", 1e6), ("g cm2", 1e7), ("g mm2", 1e9)]
)
def test_inertia_in_another_unit_is_the_only_finding(
    kind: str, unit: str, per_unit: float, tmp_path: Path
) -> None:
    text = text_of(kind)
    for moment in ("0.0072", "0.0127"):
        text = text.replace(moment, repr(float(moment) * per_unit))
    (finding,) = findings_of(tmp_path, kind, text)
    assert finding.kind == "inertia"
    assert finding.severity == "fault"
    assert unit in finding.cause
    # what is driven has an estimate in its place
    (again,) = check_robot(tmp_path / f"a.{kind}").faults
    assert again == finding.sentence
