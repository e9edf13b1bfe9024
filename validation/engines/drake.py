"""The robot in Drake: discrete dynamics, compliant point contacts, a convex friction solver.

Of its approximations of contact it is the one that Drake calls lagged: TAMSI ignores the wheels'
servos silently, and stiff contacts chatter with the others. The wheels' actuators hold given rates,
or rate 0 with the torque of dry friction; motor torques are generalised forces.
"""

from __future__ import annotations

import logging
from functools import cached_property
from typing import Any

import numpy as np

from ssmr.types import FloatArray
from validation.engines.body import SINK_SHARE, EngineMissingError, Rigid
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, WHEELS

_HOW_TO_GET_DRAKE = (
    "Drake is missing: install it with pip install 'ssmr-testbed[engines]', "
    "and compare without it until then"
)
"""Line that says how to get it."""
_STRONG = 1e6
"""Torque that given wheel rates may take [N m]."""
_DISSIPATION = 5.0
"""Hunt and Crossley's dissipation of a contact [s/m]."""
_STICTION = 1e-4
"""Slip below which a contact is taken to stick [m/s]; the best that was found
(docs/why_drift.md)."""
_HOLD = 1e5
"""Gain with which an actuator holds a wheel's rate [N m s/rad]."""


class DrakeBody:
    """The robot in a Drake diagram, see `EngineBody`; tyres are spheres, or pairs for cylinders."""

    def __init__(self, calibration: Calibration, gravity: FloatArray, dry: float) -> None:
        """Build the diagram, see `MakeBody`.

        Raises:
            EngineMissingError: Drake is not installed.
        """
        self._numbers = calibration, gravity
        self._free = _Diagram(calibration, gravity, max(dry, 1e-9))
        self._now = self._free

    @cached_property
    def _turning(self) -> _Diagram:
        return _Diagram(*self._numbers, _STRONG)

    def place(self, motion: Rigid) -> None:
        """Put the robot into a motion, see `EngineBody.place`."""
        self._now = self._free
        positions = [motion.quat_wxyz, motion.position, np.zeros(len(WHEELS))]
        velocities = [motion.spin, motion.velocity, motion.wheels]
        self._now.put(np.concatenate(positions), np.concatenate(velocities))

    def motion(self) -> Rigid:
        """Return how the robot moves now, see `EngineBody.motion`."""
        q, v = self._now.state()
        return Rigid(q[4:7], q[:4], v[3:6], v[:3], v[6:])

    def advance(self, torques: FloatArray, yaw_torque: float) -> None:
        """Take one physics step, see `EngineBody.advance`."""
        self._advance(self._free, torques, np.zeros(len(WHEELS)), yaw_torque)

    def advance_turning(self, rates: FloatArray, yaw_torque: float) -> None:
        """Take one physics step with given wheel rates, see `EngineBody.advance_turning`."""
        self._advance(self._turning, np.zeros(len(WHEELS)), rates, yaw_torque)

    def _advance(
        self, diagram: _Diagram, torques: FloatArray, rates: FloatArray, yaw_torque: float
    ) -> None:
        if diagram is not self._now:
            diagram.put(*self._now.state())
            self._now = diagram
        on_base = [0.0, 0.0, yaw_torque, 0.0, 0.0, 0.0]
        diagram.step(np.concatenate([on_base, torques]), rates)

    def wheel_loads(self) -> FloatArray:
        """Return the loads of the last step, see `EngineBody.wheel_loads`."""
        return self._now.loads()


class _Diagram:
    """A plant and its scene, with actuators of one strength [N m]."""

    def __init__(self, c: Calibration, gravity: FloatArray, strength: float) -> None:
        try:
            from pydrake.geometry import AddContactMaterial, HalfSpace, ProximityProperties, Sphere
            from pydrake.math import RigidTransform
            from pydrake.multibody import plant as multibody
            from pydrake.systems.framework import DiagramBuilder
        except ImportError as error:
            raise EngineMissingError(_HOW_TO_GET_DRAKE) from error
        log = logging.getLogger("drake")
        level = log.level
        log.setLevel(logging.ERROR)  # it warns that half spaces touch no deformable bodies
        builder = DiagramBuilder()
        empty = multibody.MultibodyPlant(c.timestep)
        plant, _ = multibody.AddMultibodyPlantSceneGraph(builder, empty)
        self._plant = plant
        plant.set_discrete_contact_approximation(multibody.DiscreteContactApproximation.kLagged)
        plant.set_contact_model(multibody.ContactModel.kPoint)
        plant.set_stiction_tolerance(_STICTION)
        plant.mutable_gravity_field().set_gravity_vector(gravity)
        loads = np.maximum(c.static_shares, 0.0) * (c.mass * GRAVITY)
        stiffness = float(loads.mean()) / (SINK_SHARE * float(c.radii.mean()))
        rubber = ProximityProperties()
        sliding = multibody.CoulombFriction(c.friction, c.friction)
        # Tyre and ground are in series, so that each has twice the stiffness of the contact.
        AddContactMaterial(_DISSIPATION, 2.0 * stiffness, sliding, rubber)
        world = plant.world_body()
        plant.RegisterCollisionGeometry(world, RigidTransform(), HalfSpace(), "ground", rubber)
        self._wheels = self._add_robot(c, strength)
        sides = (-0.5, 0.5) if c.wheel_shape == "cylinder" else (0.0,)
        radii = c.radii + loads / stiffness / len(sides)
        for wheel, radius in zip(self._wheels, radii.tolist(), strict=True):
            for side in sides:
                place: Any = [0.0, side * c.robot.wheel_width, 0.0]
                at = RigidTransform(place)
                name = f"tyre{side:+g}"
                plant.RegisterCollisionGeometry(wheel, at, Sphere(radius), name, rubber)
        plant.Finalize()
        diagram = builder.Build()
        self._context = diagram.CreateDefaultContext()
        log.setLevel(level)
        self._mine = self._plant.GetMyMutableContextFromRoot(self._context)
        self._next = None
        self._force = plant.get_applied_generalized_force_input_port()
        self._set_points = plant.get_desired_state_input_port(self._wheels[0].model_instance())
        self._results = plant.get_contact_results_output_port()
        self._index = {wheel.index(): k for k, wheel in enumerate(self._wheels)}
        self._force.FixValue(self._mine, np.zeros(6 + len(WHEELS)))
        self._set_points.FixValue(self._mine, np.zeros(2 * len(WHEELS)))

    def _add_robot(self, c: Calibration, strength: float) -> list[Any]:
        """Add base, wheels, axles and belts; return the wheels."""
        from pydrake.math import RigidTransform
        from pydrake.multibody.tree import (
            FixedOffsetFrame,
            PdControllerGains,
            RevoluteJoint,
            RotationalInertia,
            SpatialInertia,
        )

        def body(name: str, mass: float, com: Any, inertia: FloatArray) -> Any:
            moments = RotationalInertia(*inertia.tolist())
            central = SpatialInertia.MakeFromCentralInertia(mass, com, moments)
            return plant.AddRigidBody(name, central)

        plant = self._plant
        base = body("base", c.base_mass, c.com, c.base_inertia)
        across, spin = c.robot.wheel_inertia
        along_axle: Any = [0.0, 1.0, 0.0]
        wheels = []
        joints = []
        for name, place in zip(WHEELS, c.wheel_places, strict=True):
            wheel = body(name, c.robot.wheel_mass, np.zeros(3), np.array([across, spin, across]))
            at = RigidTransform(place)
            axle = plant.AddFrame(FixedOffsetFrame(f"{name}_axle", base.body_frame(), at))
            hinge = RevoluteJoint(f"{name}_joint", axle, wheel.body_frame(), along_axle)
            joint = plant.AddJoint(hinge)
            motor = plant.AddJointActuator(f"{name}_motor", joint, strength)
            motor.set_controller_gains(PdControllerGains(p=0.0, d=_HOLD))
            motor.set_default_rotor_inertia(c.armature)
            motor.set_default_gear_ratio(1.0)
            wheels.append(wheel)
            joints.append(joint)
        for group in c.robot.motor_groups:
            if len(group) == 2:
                front, rear = group
                plant.AddCouplerConstraint(joints[front], joints[rear], 1.0)
        return wheels

    def put(self, positions: FloatArray, velocities: FloatArray) -> None:
        """Set the state."""
        self._plant.SetPositions(self._mine, positions)
        self._plant.SetVelocities(self._mine, velocities)

    def state(self) -> tuple[FloatArray, FloatArray]:
        """Return (11,) attitude (w first), place, wheel angles, and (10,) the rates of these."""
        positions = self._plant.GetPositions(self._mine)
        velocities = self._plant.GetVelocities(self._mine)
        return np.array(positions), np.array(velocities)

    def step(self, forces: FloatArray, rates: FloatArray) -> None:
        """Take a physics step under (10,) generalised forces, actuators holding (4,) rates."""
        self._force.FixValue(self._mine, forces)
        self._set_points.FixValue(self._mine, np.concatenate([np.zeros(len(WHEELS)), rates]))
        # This is its discrete update; time stands still.
        self._plant.ExecuteForcedEvents(self._mine, publish=False)

    def loads(self) -> FloatArray:
        """Return the (4,) normal forces on the wheels [N]."""
        loads = np.zeros(len(WHEELS))
        results = self._results.Eval(self._mine)
        for i in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(i)
            k = self._index.get(pair.bodyB_index(), self._index.get(pair.bodyA_index()))
            if k is not None:
                loads[k] += abs(pair.contact_force()[2])
        return loads
