"""The motors of `ssmr.robot.drive` inside MuJoCo, made of its own actuators alone.

So a model is exported as it moves. A motor's torque is the sum of two actuators, which both take
the commanded wheel rate: `<velocity>` is the proportional part K_P e, and `<intvelocity>` is the
integral part, a spring of stiffness K_I between the wheel and the angle to which that rate adds up.
The other end of that spring is a slip: a light joint of its own which gives way at a rate in
proportion to the spring's torque y, so that y leaks,

    dy/dt = K_I (e - slip rate),    y = K_dc times the slip rate,    |y| at most the motor's limit,

and which slides freely once y has reached the limit, so that a wheel that is stuck does not wind it
up. Both follow from the joint's dry friction: MuJoCo's solver makes it soft, of a softness that is
chosen here, up to its limit. The torque of both parts together is limited at the wheels' joints.

MuJoCo's implicit integrator would take the feedback of a motor at its limit for a damper that still
works, and contacts would see wheels that are ahead. So models have Euler's, but where the wheels
alone would be too light for K_P and the time step: a step leaves |1 - q| of an error with Euler's
and 1 / (1 + q) with the implicit one, for q = K_P dt / inertia, so Euler's is the better one up to
the square root of two. No damping here is so strong that Euler's would have to be implicit in it,
which costs a fifteenth of a step.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from ssmr.robot.drive import motor_numbers
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, IndexArray
from validation.simulator.calibration import Calibration
from validation.simulator.description import SIDES, Robot
from validation.simulator.parts import robot_parts

SLIP_INERTIA = 0.04
"""Inertia of a slip over that of the rotors and wheels that its motor turns [1]: it weighs nothing
in a motion, and a lighter one could not be as stiff as a controller whose integral part hardly
leaks."""
_SLIP_DAMPING = 0.15
"""Damping of a sliding slip over sqrt(K_I x its inertia) [1]: the spring does not swing about the
limit."""
_NO_LIMIT = 1e12
"""Friction of the slip of a motor without a limit [N m]."""
_FAR = 3.0
"""Proportional part over the motor's limit beyond which the motor is at its limit whatever the
integral part [1]."""
_MOST_FEEDBACK = math.sqrt(2.0)
"""Feedback of a motor on its rate times the step over the inertia, up to which Euler's integrator
settles sooner than an implicit one [1]."""
_MOST_SETTLING = 5.0 / 3.0
"""Time step over the time in which slips settle, up to which these settle well [1]: each step then
takes 5 / 3 of an error away, and 2 is the end."""
_STIFFEST = 0.9999
"""Greatest impedance that MuJoCo takes [1]."""
_TENDON = mujoco.mjtTrn.mjTRN_TENDON
GIVEN_SHARE = 1000.0
"""Armature of wheels whose rates are given, over mass times wheel radius squared [1]: so heavy that
the ground cannot change them (MuJoCo does not pass an armature's reaction on to the body)."""
GIVEN_STEPS = 51.0
"""Time constant of the feedback on given wheel rates, in time steps.

It only makes up for the ground, which moves so heavy wheels by less than 0.2 mm/s, for the
references lead. It is slow because MuJoCo's contacts know nothing of implicit damping: they see
wheels that are ahead by up to one over this number of every change."""


def add_integral_parts(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add the integral parts of a robot's motors; `set_motors` sets their numbers."""
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    tiny = {"mass": 1e-9, "ipos": [0.0] * 3, "inertia": [1e-9] * 3, "explicitinertial": True}
    slips = spec.worldbody.add_body(name="slips", **tiny)
    for motor, wheels in robot.motors.items():
        slips.add_joint(name=f"{motor}_slip", axis=[0, 1, 0], armature=1.0, frictionloss=1.0)
        spring = spec.add_tendon(name=f"{motor}_spring")
        for wheel in wheels:
            spring.wrap_joint(f"{wheel}_wheel", 1.0 / len(wheels))
        spring.wrap_joint(f"{motor}_slip", 1.0)
        actuator = spec.add_actuator(name=f"{motor}_integral", target=spring.name, trntype=_TENDON)
        actuator.set_to_intvelocity(kp=1.0)


def actuator_inputs(model: mujoco.MjModel, references: FloatArray) -> FloatArray:
    """Return the (..., nu) inputs of all actuators for (..., 2) rates of the sides [rad/s]."""
    return np.concatenate([references] * (model.nu // len(SIDES)), axis=-1)


def rates_on_steps(commands: Commands, dt: float, steps: IndexArray) -> FloatArray:
    """Return the (n, 2) given wheel rates [rad/s] in the middle of physics steps of `dt` [s].

    A commanded rate is that of the middle of its period, and linear between.
    """
    middles = (np.arange(commands.n) + 0.5) * commands.dt
    at = (steps + 0.5) * dt
    return np.column_stack([np.interp(at, middles, side) for side in commands.values.T])


def lead_rates(rates: FloatArray, before: FloatArray, lead: float | FloatArray) -> FloatArray:
    """Return the references that give heavy wheels the (n, k) rates of steps without a lag.

    After a step wheels have the mean rate of the step. A feedback that takes wheels by the share s
    of what is wanted in a step reaches a rate that leads by 1 / s - 1 changes: s is h / T with the
    time constant T and the step h, where the integrator is Euler's.

    Args:
        rates: rates of the steps [rad/s].
        before: (k,) rates before the first step [rad/s].
        lead: the lead of all or of each of the (k,) wheels, in changes of a step [1].
    """
    return rates + lead * np.diff(rates, axis=0, prepend=before[None])


def set_motors(
    model: mujoco.MjModel,
    calibration: Calibration,
    drive: Drive,
    prefix: str = "",
    settling: float = 1.0,
) -> float:
    """Set the motors of `drive`, with the calibration's gain, on a compiled model, in place.

    A motor that turns one wheel of two has half of a side's numbers.

    Args:
        model: the model.
        calibration: the robot's numbers.
        drive: the motors.
        prefix: text in front of the robot's names in a larger model.
        settling: time constant of the slips, in time steps [1].

    Returns:
        The longest time step for which these numbers will do [s].
    """
    robot = calibration.robot
    motor = motor_numbers(drive, calibration.timestep)
    lost = calibration.rolling_torque + motor.gear_loss
    dofs = robot_parts(model, prefix).dofs
    limited = math.isfinite(motor.limit)
    most = 0.5 * motor.limit if limited else 0.0
    model.dof_damping[dofs] = 0.5 * motor.braking
    joints = model.dof_jntid[dofs]
    model.jnt_actfrclimited[joints] = limited
    model.jnt_actfrcrange[joints] = -most, most
    light = 2.0 * (calibration.armature + robot.wheel_inertia[1])
    feedback = max(calibration.gain, motor.braking)
    longest = _MOST_FEEDBACK * light / feedback if feedback > 0.0 else math.inf
    too_light = calibration.timestep > longest
    integrators = mujoco.mjtIntegrator
    model.opt.integrator = integrators.mjINT_IMPLICITFAST if too_light else integrators.mjINT_EULER
    for motor_name, wheels in robot.motors.items():
        name = f"{prefix}{motor_name}"
        share = 0.5 * len(wheels)
        index = model.actuator(f"{name}_motor").id
        gain = share * calibration.gain
        model.actuator_gainprm[index, 0] = gain
        model.actuator_biasprm[index, :3] = 0.0, 0.0, share * motor.braking - gain
        # This bound changes no sum with the integral part, and MuJoCo learns from it where the
        # feedback does not work.
        bounded = limited and too_light
        far = _FAR if drive.integral_gain > 0.0 else 1.0
        bound = far * share * motor.limit if bounded else 0.0
        model.actuator_forcelimited[index] = bounded
        model.actuator_forcerange[index] = -bound, bound
        model.tendon_frictionloss[model.tendon(name).id] = share * lost
        _set_integral_part(model, name, share, light, drive, settling * calibration.timestep)
    slips = _MOST_SETTLING * settling * calibration.timestep
    return slips if too_light else min(slips, longest)


def _set_integral_part(
    model: mujoco.MjModel, motor: str, share: float, light: float, drive: Drive, time: float
) -> None:
    """Set spring and slip of a motor with a share of a side.

    `light` is the inertia of the side's wheels and rotors [kg m2], `time` that in which a slip
    settles [s].
    """
    dt = model.opt.timestep
    stiffness = share * drive.integral_gain
    index = model.actuator(f"{motor}_integral").id
    model.actuator_gainprm[index, 0] = stiffness
    model.actuator_biasprm[index, :3] = 0.0, -stiffness, 0.0
    dof = int(model.joint(f"{motor}_slip").dofadr[0])
    inertia = max(share * SLIP_INERTIA * light, stiffness * dt**2)
    # Friction of impedance d that takes the rate away in a time is a damper of d / (1 - d) inertia
    # over that time, whatever the step.
    softest = 1.0 - _STIFFEST
    stopped = min(share * drive.dc_stiffness * time, inertia / softest)
    impedance = min(max(round(stopped / (stopped + inertia), 4), softest), _STIFFEST)
    solref = -1.0, -impedance / time
    if impedance < _STIFFEST:
        # a file has six digits: few of 1 - d, but enough of an inertia that goes with a d of four
        inertia = stopped * (1.0 - impedance) / impedance
    else:
        # it gives way as little as it may; MuJoCo makes this form slower where a step is longer
        solref = 2.0 * dt / impedance, 1.0
    model.dof_armature[dof] = inertia
    model.dof_damping[dof] = _SLIP_DAMPING * math.sqrt(stiffness * inertia)
    model.dof_frictionloss[dof] = min(2.0 * share * drive.torque_limit, _NO_LIMIT)
    model.dof_solimp[dof, :2] = impedance
    model.dof_solref[dof] = solref
    # The solver's softness is in proportion to the joint's inertia at compilation.
    model.dof_invweight0[dof] = 1.0 / inertia
