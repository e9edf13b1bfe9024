"""The robot in ODE, Gazebo's engine: bodies, hinges, belts, contacts and a friction law.

ODE bounds the two components of friction one by one, |f_1| <= mu N and |f_2| <= mu2 N: a square
along a first direction, if both are equal. That is `pyramid`, Gazebo's default. Its two other
friction models, as its solver has them (deps/opende/src/quickstep_pgs_lcp.cpp): `gazebo_cone`
bounds the components by mu N |v_1| / |v| and mu2 N |v_2| / |v|, with the slip v at the start of the
step; `gazebo_box` bounds them by mu and mu2 in newtons, whatever the load. The fourth law is
neither ODE's nor Gazebo's: `cone` puts the first direction along the slip and lets the second
component give as a friction cone does, f_2 = -mu N v_2 / |v|, so that it is Coulomb's cone to first
order of a step. With the exact solver it takes N from the step before, because dWorldStep bounds
friction by the normal forces that there would be without friction, in which a part of the load
transfer is missing.

Rotors turn with the wheels and their reaction reaches the base; their gyroscopic moments are left
out.
"""

from __future__ import annotations

import ctypes
import math
import threading
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.engines.body import SINK_SHARE, Rigid
from validation.engines.ode_library import (
    APPROX1,
    F_MAX,
    FDIR1,
    MU2,
    SLIP2,
    SOFT_CFM,
    SOFT_ERP,
    VEL,
    Contact,
    ContactGeom,
    JointFeedback,
    Mass,
    Vector,
    load_ode,
)
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, WHEELS

FrictionLaw = Literal["cone", "pyramid", "gazebo_cone", "gazebo_box"]
FrictionDirection = Literal["world", "wheel"]
OdeSolver = Literal["exact", "quick"]
_NO_SLIP = 1e-6
"""Slip below which its direction is noise, and the chassis' is taken [m/s]."""
_LEAST_LOAD = 0.01
"""Least load that a contact's friction is computed for, over the one at rest [1]."""
_STRONG = 1e6
"""Torque that belts and given wheel rates may take [N m]."""
_MOST_CONTACTS = 8
_ERP = 0.2
"""Share of an error that hinges and belts correct in a step [1], ODE's own."""
_SOR = 1.3
"""Over-relaxation of the quick solver [1], ODE's own."""
_TIE = 1e-10
"""Difference of the limits of two wheels [1]."""
_quick = threading.Lock()  # the quick solver's random numbers belong to the process


@dataclass(frozen=True)
class OdeSettings:
    """Settings of ODE's physics; the defaults are the best that were found (docs/why_drift.md)."""

    friction_law: FrictionLaw = "cone"
    """Law of friction, see above."""
    direction: FrictionDirection = "world"
    """First direction of all laws but `cone`: the world's -y, which ODE takes itself, or one that
    is fixed in the wheel and rolls with it, as Gazebo hands on `fdir1`."""
    solver: OdeSolver = "exact"
    """`exact` is dWorldStep, `quick` is dWorldQuickStep, successive over-relaxation in random
    order."""
    iterations: int = 50
    """Sweeps of the quick solver."""
    soft: bool = True
    """Whether contacts are springs with dampers; otherwise they have the world's `erp` and
    `cfm`."""
    kp: float = 0.0
    """Stiffness of a contact [N/m]; 0: such that tyres sink by `SINK_SHARE` of their radius."""
    kd: float = 0.0
    """Damping of a contact [N s/m]; 0: critical for a quarter of the mass."""
    cfm: float = 1e-9
    """Softness of hinges and belts [1/(N s)]; the exact solver fails below 1e-9."""
    surface_layer: float = 0.0
    """Depth that contacts are not pushed out of [m]."""
    max_correcting_velocity: float = math.inf
    """Greatest speed at which contacts are pushed out [m/s]."""
    second_share: float = 1.0
    """mu2 over mu [1]; 1 for `cone`."""


GAZEBO = OdeSettings(
    "pyramid",
    "wheel",
    "quick",
    50,
    kp=1e7,
    kd=2.0,
    cfm=0.0,
    surface_layer=1e-3,
    max_correcting_velocity=100.0,
)
"""ODE's settings as Gazebo and the maker's description of its Husky (husky_description,
urdf/wheel.urdf.xacro) set them.

The description has kp = 1e7 N/m, kd = 1 N s/m and fdir1 = (1, 0, 0). How they reach ODE is in
Gazebo's gazebo/physics/ode/ODEPhysics.cc: kp of both bodies in series (the ground's is 1e12), kd of
both added (the ground's is 1), and fdir1 turned by the pose of the wheel's collision shape, so that
it rolls with the wheel. The world has Gazebo's own: dWorldQuickStep, 50 sweeps, SOR 1.3, ERP 0.2,
CFM 0, a surface layer of 1 mm, at most 100 m/s of correction, steps of 1 ms. Gazebo carries a
changed copy of ODE, which is not run here."""
HUSKY: Mapping[str, Any] = {"wheel_shape": "cylinder", "friction": 1.0, "timestep": 0.001}
"""Fields of `Calibration` in which Gazebo's Husky differs from ours, but for its centre of mass."""
MAKERS_HUSKY: Mapping[str, Any] = {**HUSKY, "com_x": -0.00065, "com_y": -0.085}
"""All of them: the centre of mass is that of the maker's description (urdf/husky.urdf.xacro)."""


class OdeBody:
    """The robot in a world of its own, see `EngineBody`."""

    def __init__(
        self,
        calibration: Calibration,
        gravity: FloatArray,
        dry: float,
        settings: OdeSettings | None = None,
    ) -> None:
        """Build the world, by default with the best settings; see `MakeBody` for the rest.

        Raises:
            EngineMissingError: ODE is not installed.
        """
        self._robot = calibration
        self._gravity = gravity
        self._dry = dry
        self._settings = settings or OdeSettings()
        self._groups = calibration.robot.motor_groups
        self._cylinders = calibration.wheel_shape == "cylinder"
        shares = np.maximum(calibration.static_shares, 0.0)
        self._resting = shares * (calibration.mass * GRAVITY)
        self._ode = load_ode()
        self._ode.dAllocateODEDataForThread(0xFFFFFFFF)
        self._build_world()
        self._build_robot()
        self._build_contacts()
        groups = [self._contacts, self._joints]
        geoms = [self._floor, *self._tyres]
        weakref.finalize(self, _destroy_world, self._ode, self._world, groups, geoms)

    def _build_world(self) -> None:
        lib = self._ode
        s = self._settings
        self._world = lib.dWorldCreate()
        self._joints = lib.dJointGroupCreate(0)
        self._contacts = lib.dJointGroupCreate(0)
        lib.dWorldSetGravity(self._world, *self._gravity.tolist())
        lib.dWorldSetERP(self._world, _ERP)
        lib.dWorldSetCFM(self._world, s.cfm)
        lib.dWorldSetContactMaxCorrectingVel(self._world, s.max_correcting_velocity)
        lib.dWorldSetContactSurfaceLayer(self._world, s.surface_layer)
        lib.dWorldSetQuickStepNumIterations(self._world, s.iterations)
        lib.dWorldSetQuickStepW(self._world, _SOR)
        self._floor = lib.dCreatePlane(None, 0.0, 0.0, 1.0, 0.0)

    def _build_robot(self) -> None:
        """Make base, wheels, hinges and belts; hinges are made with the robot at the origin."""
        lib = self._ode
        c = self._robot
        across, spin = c.robot.wheel_inertia
        self._base = self._make_body(c.base_mass, c.base_inertia.tolist())
        wheel_inertia = [across, spin + c.armature, across]
        self._wheels = [self._make_body(c.robot.wheel_mass, wheel_inertia) for _ in WHEELS]
        bodies = [self._base, *self._wheels]
        self._views = [self._view(body) for body in bodies]
        self._rotations = [lib.dBodyGetRotation(body) for body in bodies]  # (3, 4), row by row
        self.place(Rigid.at_rest(c.base_height))
        self._hinges = []
        for wheel, place in zip(self._wheels, c.wheel_places, strict=True):
            hinge = lib.dJointCreateHinge(self._world, self._joints)
            lib.dJointAttach(hinge, wheel, self._base)
            lib.dJointSetHingeAnchor(hinge, place[0], place[1], place[2] + c.base_height)
            lib.dJointSetHingeAxis(hinge, 0.0, 1.0, 0.0)
            self._hinges.append(hinge)
        for group in self._groups:
            if len(group) != 2:
                continue
            front, rear = group
            belt = lib.dJointCreateAMotor(self._world, self._joints)
            lib.dJointAttach(belt, self._wheels[front], self._wheels[rear])
            lib.dJointSetAMotorNumAxes(belt, 1)
            lib.dJointSetAMotorAxis(belt, 0, 1, 0.0, 1.0, 0.0)
            lib.dJointSetAMotorParam(belt, VEL, 0.0)
            lib.dJointSetAMotorParam(belt, F_MAX, _STRONG)

    def _view(self, body: Any) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return place, attitude, velocity and spin of a body, in ODE's own memory."""
        lib = self._ode
        return (
            np.ctypeslib.as_array(lib.dBodyGetPosition(body), (3,)),
            np.ctypeslib.as_array(lib.dBodyGetQuaternion(body), (4,)),
            np.ctypeslib.as_array(lib.dBodyGetLinearVel(body), (3,)),
            np.ctypeslib.as_array(lib.dBodyGetAngularVel(body), (3,)),
        )

    def _make_body(self, mass: float, inertia: list[float]) -> Any:
        body = self._ode.dBodyCreate(self._world)
        numbers = Mass()
        centre = (0.0, 0.0, 0.0)
        products = (0.0, 0.0, 0.0)
        self._ode.dMassSetParameters(ctypes.byref(numbers), mass, *centre, *inertia, *products)
        self._ode.dBodySetMass(body, ctypes.byref(numbers))
        self._ode.dBodySetGyroscopicMode(body, 0)
        return body

    def _build_contacts(self) -> None:
        """Make tyres and the contact that they all share, but for place and direction."""
        lib = self._ode
        c = self._robot
        s = self._settings
        load = self._resting.sum() / len(WHEELS)
        mass = load / np.linalg.norm(self._gravity)
        radii = c.radii
        kp = s.kp or load / (SINK_SHARE * radii.mean())
        kd = s.kd or 2.0 * math.sqrt(kp * mass)
        if s.soft:
            radii = radii + self._resting / kp / (2.0 if self._cylinders else 1.0)
        # ODE's cylinders lie along z, the axles along y.
        along_axle = Vector(math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)
        self._tyres = []
        for wheel, radius in zip(self._wheels, radii.tolist(), strict=True):
            if self._cylinders:
                tyre = lib.dCreateCylinder(None, radius, c.robot.wheel_width)
            else:
                tyre = lib.dCreateSphere(None, radius)
            lib.dGeomSetBody(tyre, wheel)
            if self._cylinders:
                lib.dGeomSetOffsetQuaternion(tyre, along_axle)
            self._tyres.append(tyre)
        bounds = 0 if s.friction_law == "gazebo_box" else APPROX1  # without it, they are forces
        self._contact = Contact(mode=bounds | MU2 | FDIR1)
        self._geoms = (ContactGeom * _MOST_CONTACTS)()
        if s.soft:
            self._contact.mode |= SOFT_ERP | SOFT_CFM
            dt = c.timestep
            damped = dt * kp + kd  # of a spring with a damper; Gazebo takes these formulas too
            self._contact.soft_erp = dt * kp / damped
            self._contact.soft_cfm = 1.0 / damped
        if s.friction_law == "cone":
            self._contact.mode |= SLIP2
            if s.solver == "exact":
                self._contact.mode &= ~APPROX1
        self._feedback = [[JointFeedback() for _ in range(_MOST_CONTACTS)] for _ in WHEELS]

    def place(self, motion: Rigid) -> None:
        """Put the robot into a motion, see `EngineBody.place`."""
        lib = self._ode
        c = self._robot
        lib.dAllocateODEDataForThread(0xFFFFFFFF)
        turn = _rotation_matrix(motion.quat_wxyz)
        axle = turn[:, 1]
        bodies = [self._base, *self._wheels]
        offsets = [c.com, *c.wheel_places]
        rates = [0.0, *motion.wheels]  # the base has no rate of its own
        for body, offset, rate in zip(bodies, offsets, rates, strict=True):
            arm = turn @ offset
            velocity = motion.velocity + np.cross(motion.spin, arm)
            spin = motion.spin + axle * rate
            lib.dBodySetPosition(body, *(motion.position + arm).tolist())
            lib.dBodySetQuaternion(body, Vector(*motion.quat_wxyz.tolist()))
            lib.dBodySetLinearVel(body, *velocity.tolist())
            lib.dBodySetAngularVel(body, *spin.tolist())
        self._loads = self._resting.tolist()
        self._steps = 0
        self._points = [1] * len(WHEELS)

    def motion(self) -> Rigid:
        """Return how the robot moves now, see `EngineBody.motion`."""
        place, quat, velocity, spin = self._views[0]
        turn = _rotation_matrix(quat)
        arm = turn @ self._robot.com
        axle = turn[:, 1]
        rates = np.array([(wheel_spin - spin) @ axle for *_, wheel_spin in self._views[1:]])
        base_velocity = velocity - np.cross(spin, arm)
        return Rigid(place - arm, np.array(quat), base_velocity, np.array(spin), rates)

    def advance(self, torques: FloatArray, yaw_torque: float) -> None:
        """Take one physics step, see `EngineBody.advance`."""
        for hinge, torque in zip(self._hinges, torques.tolist(), strict=True):
            self._ode.dJointAddHingeTorque(hinge, torque)
        self._turn_hinges([0.0] * len(WHEELS), self._dry)
        self._step(yaw_torque)

    def advance_turning(self, rates: FloatArray, yaw_torque: float) -> None:
        """Take one physics step with given wheel rates, see `EngineBody.advance_turning`."""
        self._turn_hinges(rates.tolist(), _STRONG)
        self._step(yaw_torque)

    def _turn_hinges(self, rates: list[float], limit: float) -> None:
        """Let the hinges' motors hold rates [rad/s] up to a limit [N m]; rate 0 is dry friction."""
        # One motor a belt, which passes it on: two would reach their limits at once.
        for group in self._groups:
            first = group[0]
            hinge = self._hinges[first]
            torque = limit * len(group) * _tie_breaker(first)
            self._ode.dJointSetHingeParam(hinge, VEL, rates[first])
            self._ode.dJointSetHingeParam(hinge, F_MAX, torque)

    def _step(self, yaw_torque: float) -> None:
        lib = self._ode
        dt = self._robot.timestep
        lib.dBodyAddTorque(self._base, 0.0, 0.0, yaw_torque)
        for k in range(len(WHEELS)):
            self._touch(k)
        if self._settings.solver == "quick":
            with _quick:
                lib.dRandSetSeed(self._steps)
                lib.dWorldQuickStep(self._world, dt)
        else:
            lib.dWorldStep(self._world, dt)
        self._steps += 1
        lib.dJointGroupEmpty(self._contacts)
        for k, count in enumerate(self._points):
            self._loads[k] = sum(feedback.f1[2] for feedback in self._feedback[k][:count])

    def _touch(self, k: int) -> None:
        lib = self._ode
        geoms = self._geoms
        contact = self._contact
        size = ctypes.sizeof(ContactGeom)
        count = lib.dCollide(self._tyres[k], self._floor, _MOST_CONTACTS, geoms, size)
        self._points[k] = count
        for i in range(count):
            contact.geom = geoms[i]
            if self._settings.friction_law == "cone":
                self._along_slip(k, geoms[i], count)
            else:
                self._along_axes(k, geoms[i])
            joint = lib.dJointCreateContact(self._world, self._contacts, ctypes.byref(contact))
            lib.dJointAttach(joint, self._wheels[k], None)
            lib.dJointSetFeedback(joint, ctypes.byref(self._feedback[k][i]))

    def _slip(self, k: int, at: ContactGeom) -> tuple[float, float, float]:
        """Return the velocity of the wheel with index `k` at a contact [m/s]."""
        place, _, velocity, spin = self._views[1 + k]
        px, py, pz = place.tolist()
        vx, vy, vz = velocity.tolist()
        sx, sy, sz = spin.tolist()
        rx = at.pos[0] - px
        ry = at.pos[1] - py
        rz = at.pos[2] - pz
        return vx + sy * rz - sz * ry, vy + sz * rx - sx * rz, vz + sx * ry - sy * rx

    def _along_axes(self, k: int, at: ContactGeom) -> None:
        """Set a contact's first direction by the settings, and bound both components."""
        s = self._settings
        contact = self._contact
        if s.direction == "world":
            x = 0.0
            y = -1.0
            z = 0.0
        else:
            rotation = self._rotations[1 + k]
            x = rotation[0]
            y = rotation[4]
            z = rotation[8]
        contact.fdir1[:3] = (x, y, z)
        mu = self._robot.friction * _tie_breaker(k)
        contact.mu = mu
        contact.mu2 = mu * s.second_share
        if s.friction_law == "gazebo_cone":
            vx, vy, vz = self._slip(k, at)
            first = vx * x + vy * y + vz * z
            second = vy * x - vx * y
            speed = math.hypot(first, second) or 1.0
            contact.mu *= abs(first) / speed
            contact.mu2 *= abs(second) / speed

    def _along_slip(self, k: int, at: ContactGeom, points: int) -> None:
        """Set a contact's first direction along its slip, and let the second give as in a cone."""
        contact = self._contact
        friction = self._robot.friction
        x, y, _ = self._slip(k, at)
        slip = math.hypot(x, y)
        load = max(self._loads[k], _LEAST_LOAD * self._resting[k]) / points
        contact.slip2 = slip / (friction * load)
        bound = friction * (load if self._settings.solver == "exact" else 1.0)
        contact.mu = contact.mu2 = bound * _tie_breaker(k)
        if slip < _NO_SLIP:
            x = self._rotations[0][0]
            y = self._rotations[0][4]
            slip = math.hypot(x, y)
        contact.fdir1[:3] = (x / slip, y / slip, 0.0)

    def wheel_loads(self) -> FloatArray:
        """Return the loads of the last step, see `EngineBody.wheel_loads`."""
        return np.array(self._loads)


def _tie_breaker(k: int) -> float:
    """A factor next to 1, different for each wheel: the exact solver fails at equal limits."""
    return 1.0 + _TIE * (k + 1)


def _rotation_matrix(quat: FloatArray) -> FloatArray:
    """Return the (3, 3) matrix of a rotation, w first."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, quat)
    return turn.reshape(3, 3)


def _destroy_world(lib: Any, world: Any, groups: list[Any], geoms: list[Any]) -> None:
    for geom in geoms:
        lib.dGeomDestroy(geom)
    for group in groups:
        lib.dJointGroupDestroy(group)
    lib.dWorldDestroy(world)
