"""Sound models of skid-steering robots in three formats, for blind tests.

They share nothing with the project. `tests/test_robot_diseases.py` makes them ill.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, fromstring

CORNERS = ("front_left", "front_right", "rear_left", "rear_right")


@dataclass(frozen=True)
class Spec:
    """A robot: metres, kilograms; its axles lie in the base's origin."""

    mass: float
    """Mass of the body without its wheels."""
    wheelbase: float
    track: float
    radius: float
    width: float
    wheel_mass: float
    body: tuple[float, float, float]
    mu: float = 0.8
    high: float = 0.06
    """Height of the body's middle above the axles."""

    @property
    def total(self) -> float:
        """Mass of all [kg]."""
        return self.mass + 4 * self.wheel_mass

    @property
    def multiplier(self) -> float:
        """By how much wheels must turn more than rolling ones: 1 + L^2 / B^2."""
        return 1 + (self.wheelbase / self.track) ** 2

    @property
    def torque(self) -> float:
        """That a wheel needs in a turn on the spot, about [N m]."""
        diagonal = math.hypot(self.wheelbase, self.track)
        return self.mu * self.total * 9.81 / 4 * self.radius * self.wheelbase / diagonal

    def place(self, corner: str) -> tuple[float, float, float]:
        """Where a wheel's axle is.

        Returns:
            x, y, z in the base [m].
        """
        x = self.wheelbase / 2 * (1 if corner.startswith("front") else -1)
        return x, self.track / 2 * (1 if corner.endswith("left") else -1), 0.0

    def wheel_inertia(self) -> tuple[float, float, float]:
        """Of a wheel as a cylinder about y.

        Returns:
            Moments about x, y, z [kg m^2].
        """
        across = self.wheel_mass * (3 * self.radius**2 + self.width**2) / 12
        return across, self.wheel_mass * self.radius**2 / 2, across

    def body_inertia(self) -> tuple[float, float, float]:
        """Of the body as a box.

        Returns:
            Moments about x, y, z [kg m^2].
        """
        a, b, c = self.body
        m = self.mass / 12
        return m * (b * b + c * c), m * (a * a + c * c), m * (a * a + b * b)


SPECS = {
    "toy": Spec(4.0, 0.18, 0.22, 0.05, 0.03, 0.25, (0.26, 0.16, 0.06), high=0.02),
    "desk": Spec(14.0, 0.26, 0.36, 0.098, 0.04, 0.48, (0.40, 0.28, 0.12)),
    "crate": Spec(30.0, 0.42, 0.52, 0.14, 0.08, 1.8, (0.62, 0.40, 0.18)),
    "long": Spec(60.0, 0.62, 0.58, 0.165, 0.10, 2.6, (0.90, 0.44, 0.22), mu=0.6),
    "mule": Spec(160.0, 0.80, 0.90, 0.20, 0.14, 6.0, (1.10, 0.70, 0.30), mu=0.7, high=0.12),
    "ox": Spec(420.0, 0.95, 1.15, 0.29, 0.20, 14.0, (1.30, 0.85, 0.40), mu=0.7, high=0.15),
}


def words(*numbers: float) -> str:
    """Numbers as an attribute.

    Returns:
        Them with blanks between.
    """
    return " ".join(f"{number:.7g}" for number in numbers)


# ---------------------------------------------------------------------------------- URDF


def urdf_inertial(spec: Spec, link: Element, mass: float, moments: tuple, z: float) -> None:
    """Append <inertial>."""
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=words(0, 0, z), rpy="0 0 0")
    SubElement(inertial, "mass", value=words(mass))
    names = dict(zip(("ixx", "iyy", "izz"), map(words, moments), strict=True))
    SubElement(inertial, "inertia", **names, ixy="0", ixz="0", iyz="0")


def write_urdf(spec: Spec) -> Element:
    """A URDF with Gazebo's plugin of a differential drive.

    Returns:
        Its root.
    """
    robot = Element("robot", name="stranger")
    base = SubElement(robot, "link", name="base_link")
    urdf_inertial(spec, base, spec.mass, spec.body_inertia(), spec.high)
    for tag in ("visual", "collision"):
        shape = SubElement(base, tag)
        SubElement(shape, "origin", xyz=words(0, 0, spec.high), rpy="0 0 0")
        SubElement(SubElement(shape, "geometry"), "box", size=words(*spec.body))
    for corner in CORNERS:
        link = SubElement(robot, "link", name=f"{corner}_wheel")
        urdf_inertial(spec, link, spec.wheel_mass, spec.wheel_inertia(), 0.0)
        shape = SubElement(link, "collision")
        SubElement(shape, "origin", xyz="0 0 0", rpy=words(math.pi / 2, 0, 0))
        size = {"radius": words(spec.radius), "length": words(spec.width)}
        SubElement(SubElement(shape, "geometry"), "cylinder", **size)
        joint = SubElement(robot, "joint", name=f"{corner}_joint", type="continuous")
        SubElement(joint, "parent", link="base_link")
        SubElement(joint, "child", link=f"{corner}_wheel")
        SubElement(joint, "origin", xyz=words(*spec.place(corner)), rpy="0 0 0")
        SubElement(joint, "axis", xyz="0 1 0")
        speed = 2.0 / spec.radius
        SubElement(joint, "limit", effort=words(3 * spec.torque), velocity=words(speed))
        gazebo = SubElement(robot, "gazebo", reference=f"{corner}_wheel")
        stiff = 1e4 * spec.total
        for tag, value in (("mu1", spec.mu), ("mu2", spec.mu), ("kp", stiff), ("kd", 100)):
            SubElement(gazebo, tag).text = words(value)
    add_plugin(SubElement(robot, "gazebo"), spec)
    return robot


def add_plugin(parent: Element, spec: Spec) -> None:
    """Append Gazebo's differential drive, whose separation allows for slip."""
    name = {"filename": "gz-sim-diff-drive-system", "name": "gz::sim::systems::DiffDrive"}
    plugin = SubElement(parent, "plugin", **name)
    for side in ("left", "right"):
        for end in ("front", "rear"):
            SubElement(plugin, f"{side}_joint").text = f"{end}_{side}_joint"
    SubElement(plugin, "wheel_separation").text = words(spec.track * spec.multiplier)
    SubElement(plugin, "wheel_radius").text = words(spec.radius)
    SubElement(plugin, "topic").text = "cmd_vel"


# ----------------------------------------------------------------------------------- SDF


def sdf_inertial(link: Element, mass: float, moments: tuple, z: float) -> None:
    """Append <inertial>."""
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "pose").text = words(0, 0, z, 0, 0, 0)
    SubElement(inertial, "mass").text = words(mass)
    inertia = SubElement(inertial, "inertia")
    for tag, value in zip(("ixx", "iyy", "izz"), moments, strict=True):
        SubElement(inertia, tag).text = words(value)
    for tag in ("ixy", "ixz", "iyz"):
        SubElement(inertia, tag).text = "0"


def write_sdf(spec: Spec) -> Element:
    """An SDF model with Gazebo's plugin of a differential drive.

    Returns:
        Its root.
    """
    sdf = Element("sdf", version="1.7")
    model = SubElement(sdf, "model", name="stranger")
    SubElement(model, "pose").text = words(0, 0, spec.radius, 0, 0, 0)
    base = SubElement(model, "link", name="base_link")
    sdf_inertial(base, spec.mass, spec.body_inertia(), spec.high)
    hull = SubElement(base, "collision", name="hull")
    SubElement(hull, "pose").text = words(0, 0, spec.high, 0, 0, 0)
    SubElement(SubElement(SubElement(hull, "geometry"), "box"), "size").text = words(*spec.body)
    for corner in CORNERS:
        link = SubElement(model, "link", name=f"{corner}_wheel")
        SubElement(link, "pose").text = words(*spec.place(corner), 0, 0, 0)
        sdf_inertial(link, spec.wheel_mass, spec.wheel_inertia(), 0.0)
        tyre = SubElement(link, "collision", name="tyre")
        SubElement(tyre, "pose").text = words(0, 0, 0, math.pi / 2, 0, 0)
        cylinder = SubElement(SubElement(tyre, "geometry"), "cylinder")
        SubElement(cylinder, "radius").text = words(spec.radius)
        SubElement(cylinder, "length").text = words(spec.width)
        surface = SubElement(tyre, "surface")
        ode = SubElement(SubElement(surface, "friction"), "ode")
        SubElement(ode, "mu").text = words(spec.mu)
        SubElement(ode, "mu2").text = words(spec.mu)
        contact = SubElement(SubElement(surface, "contact"), "ode")
        SubElement(contact, "kp").text = words(1e4 * spec.total)
        SubElement(contact, "kd").text = "100"
        joint = SubElement(model, "joint", name=f"{corner}_joint", type="revolute")
        SubElement(joint, "parent").text = "base_link"
        SubElement(joint, "child").text = f"{corner}_wheel"
        axis = SubElement(joint, "axis")
        SubElement(axis, "xyz").text = "0 1 0"
        limit = SubElement(axis, "limit")
        SubElement(limit, "lower").text = "-1e16"
        SubElement(limit, "upper").text = "1e16"
        SubElement(limit, "effort").text = words(3 * spec.torque)
        SubElement(limit, "velocity").text = words(2.0 / spec.radius)
    add_plugin(model, spec)
    return sdf


# ---------------------------------------------------------------------------------- MJCF


def write_mjcf(spec: Spec, shape: str = "ellipsoid") -> Element:
    """An MJCF with contact and servos that do what they should.

    Returns:
        Its root.
    """
    root = fromstring('<mujoco model="stranger"><compiler autolimits="true"/></mujoco>')
    option = {"cone": "elliptic", "impratio": "100", "timestep": "0.002"}
    SubElement(root, "option", **option, integrator="implicitfast")
    SubElement(root, "asset")
    world = SubElement(root, "worldbody")
    plane = {"type": "plane", "size": "30 30 0.1", "friction": words(spec.mu, 0.005, 0.0001)}
    SubElement(world, "geom", name="ground", **plane)
    base = SubElement(world, "body", name="base", pos=words(0, 0, spec.radius * 1.02))
    SubElement(base, "freejoint", name="root")
    moments = words(*spec.body_inertia())
    weight = {"pos": words(0, 0, spec.high), "mass": words(spec.mass), "diaginertia": moments}
    SubElement(base, "inertial", **weight)
    half = words(*(length / 2 for length in spec.body))
    hull = {"type": "box", "size": half, "pos": words(0, 0, spec.high)}
    SubElement(base, "geom", name="hull", **hull, contype="0", conaffinity="0")
    actuator = SubElement(root, "actuator")
    soft = {"solimp": "0.1 0.95 0.005 0.5 2", "priority": "1"}
    for corner in CORNERS:
        wheel = SubElement(base, "body", name=corner, pos=words(*spec.place(corner)))
        inertia = {"mass": words(spec.wheel_mass), "diaginertia": words(*spec.wheel_inertia())}
        SubElement(wheel, "inertial", pos="0 0 0", **inertia)
        armature = words(0.04 * spec.total * spec.radius**2)
        joint = {"type": "hinge", "axis": "0 1 0", "armature": armature}
        SubElement(wheel, "joint", name=f"{corner}_hinge", **joint)
        tyre = {"friction": words(spec.mu, 0.005, 0.0001), **soft}
        SubElement(wheel, "geom", name=f"{corner}_tyre", **tyre, **tyre_shape(spec, shape))
        gain = words(spec.torque * spec.radius / 0.003)
        servo = {"name": f"{corner}_servo", "joint": f"{corner}_hinge", "kv": gain}
        SubElement(actuator, "velocity", **servo)
    return root


def tyre_shape(spec: Spec, shape: str) -> dict[str, str]:
    """Attributes of a tyre about y.

    Returns:
        Type, size and direction.
    """
    r, half = spec.radius, spec.width / 2
    if shape == "cylinder":
        return {"type": shape, "size": words(r, half), "zaxis": "0 1 0"}
    if shape == "sphere":
        return {"type": shape, "size": words(r)}
    return {"type": "ellipsoid", "size": words(r, r, half), "zaxis": "0 1 0"}
