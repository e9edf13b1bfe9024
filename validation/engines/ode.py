"""The robot in ODE, Gazebo's engine: bodies, hinges, belts and contacts with the friction law that is asked for.

ODE bounds the two components of friction one by one, |f_1| <= mu N and |f_2| <= mu2 N: a square along a first direction,
if both are equal. That is `pyramid`, Gazebo's default. Its two other friction models, as its solver has them
(deps/opende/src/quickstep_pgs_lcp.cpp): `gazebo_cone` bounds the components by mu N |v_1| / |v| and mu2 N |v_2| / |v|, with
the slip v at the start of the step; `gazebo_box` bounds them by mu and mu2 in newtons, whatever the load. The fourth law is
neither ODE's nor Gazebo's: `cone` puts the first direction along the slip and lets the second component give as a friction
cone does, f_2 = -mu N v_2 / |v|, so that it is Coulomb's cone to first order of a step. With the exact solver it takes N
from the step before, because dWorldStep bounds friction by the normal forces that there would be without friction, in which
a part of the load transfer is missing.

Rotors turn with the wheels and their reaction reaches the base; their gyroscopic moments are left out.
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
from validation.engines.body import SINK_SHARE, Rigid, RigidNumbers
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
    ode,
)
from validation.simulator.description import WHEELS

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
_ERP, _SOR = 0.2, 1.3
"""Share of an error that hinges and belts correct in a step [1], and the quick solver's over-relaxation [1]: ODE's own."""
_TIE = 1e-10
"""Difference of the limits of two wheels [1]."""
_quick = threading.Lock()  # the quick solver's random numbers belong to the process


@dataclass(frozen=True)
class OdeSettings:
    """Settings of ODE's physics; the defaults are the best that were found (docs/why_drift.md)."""

    friction_law: FrictionLaw = "cone"
    """Law of friction, see above."""
    direction: FrictionDirection = "world"
    """First direction of all laws but `cone`: the world's -y, which ODE takes itself, or one that is fixed in the wheel and
    rolls with it, as Gazebo hands on `fdir1`."""
    solver: OdeSolver = "exact"
    """`exact` is dWorldStep, `quick` is dWorldQuickStep, successive over-relaxation in random order."""
    iterations: int = 50
    """Sweeps of the quick solver."""
    soft: bool = True
    """Whether contacts are springs with dampers; otherwise they have the world's `erp` and `cfm`."""
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
    "pyramid", "wheel", "quick", 50, kp=1e7, kd=2.0, cfm=0.0, surface_layer=1e-3, max_correcting_velocity=100.0
)
"""ODE's settings as Gazebo and the maker's description of its Husky (husky_description, urdf/wheel.urdf.xacro) set them.

The description has kp = 1e7 N/m, kd = 1 N s/m and fdir1 = (1, 0, 0). How they reach ODE is in Gazebo's
gazebo/physics/ode/ODEPhysics.cc: kp of both bodies in series (the ground's is 1e12), kd of both added (the ground's is 1),
and fdir1 turned by the pose of the wheel's collision shape, so that it rolls with the wheel. The world has Gazebo's own:
dWorldQuickStep, 50 sweeps, SOR 1.3, ERP 0.2, CFM 0, a surface layer of 1 mm, at most 100 m/s of correction, steps of 1 ms.
Gazebo carries a changed copy of ODE, which is not run here."""
HUSKY: Mapping[str, Any] = {"wheel_shape": "cylinder", "friction": 1.0, "timestep": 0.001}
"""Fields of `Calibration` in which Gazebo's Husky differs from ours, but for its centre of mass."""
MAKERS_HUSKY: Mapping[str, Any] = {**HUSKY, "com_x": -0.00065, "com_y": -0.085}
"""All of them: the centre of mass is that of the maker's description (urdf/husky.urdf.xacro)."""


class OdeBody:
    """The robot in a world of its own, see `EngineBody`."""

    def __init__(self, numbers: RigidNumbers, settings: OdeSettings) -> None:
        """Build the world.

        Raises:
            EngineMissingError: ODE is not installed.
        """
        self._n, self._settings, self._ode = numbers, settings, ode()
        self._ode.dAllocateODEDataForThread(0xFFFFFFFF)
        self._build_world()
        self._build_robot()
        self._build_contacts()
        ids = self._ode, self._world, [self._contacts, self._joints], [self._floor, *self._tyres]
        weakref.finalize(self, _destroy, *ids)

    def _build_world(self) -> None:
        lib, s = self._ode, self._settings
        self._world, self._joints, self._contacts = lib.dWorldCreate(), lib.dJointGroupCreate(0), lib.dJointGroupCreate(0)
        lib.dWorldSetGravity(self._world, *self._n.gravity.tolist())
        lib.dWorldSetERP(self._world, _ERP)
        lib.dWorldSetCFM(self._world, s.cfm)
        lib.dWorldSetContactMaxCorrectingVel(self._world, s.max_correcting_velocity)
        lib.dWorldSetContactSurfaceLayer(self._world, s.surface_layer)
        lib.dWorldSetQuickStepNumIterations(self._world, s.iterations)
        lib.dWorldSetQuickStepW(self._world, _SOR)
        self._floor = lib.dCreatePlane(None, 0.0, 0.0, 1.0, 0.0)

    def _build_robot(self) -> None:
        """Make base, wheels, hinges and belts; hinges are made where the robot stands at the origin."""
        lib, n = self._ode, self._n
        across, spin = n.wheel_inertia
        self._base = self._make_body(n.base_mass, n.base_inertia.tolist())
        wheel_inertia = [across, spin + n.armature, across]
        self._wheels = [self._make_body(n.wheel_mass, wheel_inertia) for _ in WHEELS]
        everything = [self._base, *self._wheels]
        self._views = [
            tuple(np.ctypeslib.as_array(get(b), (4 if get is lib.dBodyGetQuaternion else 3,)) for get in (
                lib.dBodyGetPosition, lib.dBodyGetQuaternion, lib.dBodyGetLinearVel, lib.dBodyGetAngularVel
            ))
            for b in everything
        ]  # fmt: skip
        self._turned = [lib.dBodyGetRotation(b) for b in everything]  # (3, 4), row by row
        still = np.zeros(3)
        self.place(Rigid(np.array([0.0, 0.0, n.height]), np.array([1.0, 0.0, 0.0, 0.0]), still, still, np.zeros(4)))
        self._hinges = []
        for wheel, place in zip(self._wheels, n.places, strict=True):
            hinge = lib.dJointCreateHinge(self._world, self._joints)
            lib.dJointAttach(hinge, wheel, self._base)
            lib.dJointSetHingeAnchor(hinge, place[0], place[1], place[2] + n.height)
            lib.dJointSetHingeAxis(hinge, 0.0, 1.0, 0.0)
            self._hinges.append(hinge)
        for front, rear in (group for group in n.groups if len(group) == 2):
            belt = lib.dJointCreateAMotor(self._world, self._joints)
            lib.dJointAttach(belt, self._wheels[front], self._wheels[rear])
            lib.dJointSetAMotorNumAxes(belt, 1)
            lib.dJointSetAMotorAxis(belt, 0, 1, 0.0, 1.0, 0.0)
            lib.dJointSetAMotorParam(belt, VEL, 0.0)
            lib.dJointSetAMotorParam(belt, F_MAX, _STRONG)

    def _make_body(self, mass: float, inertia: list[float]) -> Any:
        body, numbers = self._ode.dBodyCreate(self._world), Mass()
        self._ode.dMassSetParameters(ctypes.byref(numbers), mass, 0.0, 0.0, 0.0, *inertia, 0.0, 0.0, 0.0)
        self._ode.dBodySetMass(body, ctypes.byref(numbers))
        self._ode.dBodySetGyroscopicMode(body, 0)
        return body

    def _build_contacts(self) -> None:
        """Make tyres and the contact that they all share, but for place and direction."""
        lib, n, s = self._ode, self._n, self._settings
        load, mass = float(n.loads.sum()) / len(WHEELS), float(n.loads.sum()) / len(WHEELS) / np.linalg.norm(n.gravity)
        kp = s.kp or load / (SINK_SHARE * float(n.radii.mean()))
        kd = s.kd or 2.0 * math.sqrt(kp * mass)
        sink = n.loads / kp / (2.0 if n.cylinders else 1.0) if s.soft else np.zeros(len(WHEELS))
        self._tyres = []
        for wheel, radius in zip(self._wheels, (n.radii + sink).tolist(), strict=True):
            tyre = lib.dCreateCylinder(None, radius, n.width) if n.cylinders else lib.dCreateSphere(None, radius)
            lib.dGeomSetBody(tyre, wheel)
            if n.cylinders:
                lib.dGeomSetOffsetQuaternion(tyre, Vector(math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0))
            self._tyres.append(tyre)
        bounds = 0 if s.friction_law == "gazebo_box" else APPROX1  # without it, they are forces
        self._contact, self._geoms = Contact(mode=bounds | MU2 | FDIR1), (ContactGeom * _MOST_CONTACTS)()
        if s.soft:
            self._contact.mode |= SOFT_ERP | SOFT_CFM
            damped = n.dt * kp + kd  # of a spring with a damper; Gazebo takes these formulas too
            self._contact.soft_erp, self._contact.soft_cfm = n.dt * kp / damped, 1.0 / damped
        if s.friction_law == "cone":
            self._contact.mode |= SLIP2
            if s.solver == "exact":
                self._contact.mode &= ~APPROX1
        self._feedback = [[JointFeedback() for _ in range(_MOST_CONTACTS)] for _ in WHEELS]

    def place(self, motion: Rigid) -> None:
        """Put the robot into a motion, see `EngineBody.place`."""
        lib, n = self._ode, self._n
        lib.dAllocateODEDataForThread(0xFFFFFFFF)
        turn = _rotation(motion.quat_wxyz)
        axle = turn[:, 1]
        for k, (body, offset) in enumerate(zip([self._base, *self._wheels], [n.com, *n.places], strict=True)):
            arm = turn @ offset
            lib.dBodySetPosition(body, *(motion.position + arm).tolist())
            lib.dBodySetQuaternion(body, Vector(*motion.quat_wxyz.tolist()))
            lib.dBodySetLinearVel(body, *(motion.velocity + np.cross(motion.spin, arm)).tolist())
            spin = motion.spin + (axle * motion.wheels[k - 1] if k else 0.0)
            lib.dBodySetAngularVel(body, *spin.tolist())
        self._loads, self._steps = n.loads.tolist(), 0
        self._points = [1] * len(WHEELS)

    def motion(self) -> Rigid:
        """Return how the robot moves now, see `EngineBody.motion`."""
        place, quat, velocity, spin = self._views[0]
        turn = _rotation(quat)
        arm, axle = turn @ self._n.com, turn[:, 1]
        rates = np.array([(view[3] - spin) @ axle for view in self._views[1:]])
        return Rigid(place - arm, np.array(quat), velocity - np.cross(spin, arm), np.array(spin), rates)

    def advance(self, torques: FloatArray, yaw_torque: float) -> None:
        """Take one physics step, see `EngineBody.advance`."""
        for hinge, torque in zip(self._hinges, torques.tolist(), strict=True):
            self._ode.dJointAddHingeTorque(hinge, torque)
        self._turn_hinges([0.0] * len(WHEELS), self._n.dry)
        self._step(yaw_torque)

    def advance_turning(self, rates: FloatArray, yaw_torque: float) -> None:
        """Take one physics step with given wheel rates, see `EngineBody.advance_turning`."""
        self._turn_hinges(rates.tolist(), _STRONG)
        self._step(yaw_torque)

    def _turn_hinges(self, rates: list[float], limit: float) -> None:
        """Let the hinges' own motors hold rates [rad/s] with up to a limit [N m]; with rate 0 that is dry friction."""
        for group in self._n.groups:  # a belt passes it on: two motors on one belt would reach their limits at once
            hinge = self._hinges[group[0]]
            self._ode.dJointSetHingeParam(hinge, VEL, rates[group[0]])
            self._ode.dJointSetHingeParam(hinge, F_MAX, limit * len(group) * _untied(group[0]))

    def _step(self, yaw_torque: float) -> None:
        lib, dt = self._ode, self._n.dt
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
        self._loads = [sum(f.f1[2] for f in feedback[:m]) for feedback, m in zip(self._feedback, self._points, strict=True)]

    def _touch(self, k: int) -> None:
        lib, geoms, contact = self._ode, self._geoms, self._contact
        count = lib.dCollide(self._tyres[k], self._floor, _MOST_CONTACTS, geoms, ctypes.sizeof(ContactGeom))
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
        (px, py, pz), (vx, vy, vz), (sx, sy, sz) = place.tolist(), velocity.tolist(), spin.tolist()
        rx, ry, rz = at.pos[0] - px, at.pos[1] - py, at.pos[2] - pz
        return vx + sy * rz - sz * ry, vy + sz * rx - sx * rz, vz + sx * ry - sy * rx

    def _along_axes(self, k: int, at: ContactGeom) -> None:
        """Put the first direction of a contact where the settings say, and bound both components."""
        s, contact = self._settings, self._contact
        if s.direction == "world":
            x, y, z = 0.0, -1.0, 0.0
        else:
            x, y, z = self._turned[1 + k][0], self._turned[1 + k][4], self._turned[1 + k][8]
        contact.fdir1[0], contact.fdir1[1], contact.fdir1[2] = x, y, z
        mu = self._n.friction * _untied(k)
        contact.mu, contact.mu2 = mu, mu * s.second_share
        if s.friction_law == "gazebo_cone":
            vx, vy, vz = self._slip(k, at)
            first, second = vx * x + vy * y + vz * z, vy * x - vx * y
            speed = math.hypot(first, second) or 1.0
            contact.mu *= abs(first) / speed
            contact.mu2 *= abs(second) / speed

    def _along_slip(self, k: int, at: ContactGeom, points: int) -> None:
        """Put the first direction of a contact along its slip, and let the second give as a cone does."""
        x, y, _ = self._slip(k, at)
        slip = math.hypot(x, y)
        load = max(self._loads[k], _LEAST_LOAD * self._n.loads[k]) / points
        self._contact.slip2 = slip / (self._n.friction * load)
        bound = self._n.friction * (load if self._settings.solver == "exact" else 1.0)
        self._contact.mu = self._contact.mu2 = bound * _untied(k)
        if slip < _NO_SLIP:
            x, y = self._turned[0][0], self._turned[0][4]
            slip = math.hypot(x, y)
        self._contact.fdir1[0], self._contact.fdir1[1], self._contact.fdir1[2] = x / slip, y / slip, 0.0

    def wheel_loads(self) -> FloatArray:
        """Return the loads of the last step, see `EngineBody.wheel_loads`."""
        return np.array(self._loads)


def _untied(k: int) -> float:
    """Return a factor next to 1, other for each wheel: where two limits are reached at once, the exact solver gives up."""
    return 1.0 + _TIE * (k + 1)


def _rotation(quat: FloatArray) -> FloatArray:
    """Return the (3, 3) matrix of a rotation, w first."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, quat)
    return turn.reshape(3, 3)


def _destroy(lib: Any, world: Any, groups: list[Any], geoms: list[Any]) -> None:
    for geom in geoms:
        lib.dGeomDestroy(geom)
    for group in groups:
        lib.dJointGroupDestroy(group)
    lib.dWorldDestroy(world)
