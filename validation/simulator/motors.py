"""The motors of `ssmr.robot.drive` inside MuJoCo, the same to rounding in single steps, rollouts, batches and dm_control.

MuJoCo has no actuator with an integral part that leaks and is held within a limit, but it asks a callback how an actuator's
activations change. Ours is compiled and takes no interpreter lock. A motor's actuator has two activations: the integral part
of its torque, and what its controller asks for but for the feedback, K_P times the wanted rate plus the integral part.
MuJoCo applies the latter as it is after the step (`actearly`), which is what is wanted now. The feedback -K_P w is the
actuator's bias, which implicitfast treats implicitly, and the motor's limit is the actuator's.

Motion is of first order in the time step. Where motors stay at their limit, as on trajectory 1 with 7 N m a wheel, the path
ends 4 mm from that of the same law applied as a force with a step of 2 ms, 2 mm with 1 ms and 1 mm with 0.5 ms.
"""

from __future__ import annotations

import math
import threading
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numba import types

from ssmr._jit import compiled_for_c
from ssmr.robot.drive import motor_numbers
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, SIDES, Robot
from validation.simulator.memory import number, offset, set_number
from validation.simulator.parts import robot_parts

_LONGEST = 1e6
"""Longest time constant of a winding [s]: MuJoCo's exponential would round a longer one."""
_INSTALLING = threading.Lock()
"""One thread at a time compiles the callback: others would take what they compile for another program's."""
_VOLTAGE = int(mujoco.mjtCtrlInput.mjINPUT_VOLTAGE)


def add_controllers(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Let the callback control the motors of a robot; `set_motors` sets their numbers on the compiled model."""
    for motor in robot.motors:
        actuator = spec.actuator(f"{motor}_motor")
        actuator.dyntype, actuator.actdim, actuator.actearly = mujoco.mjtDyn.mjDYN_USER, 2, True


def add_windings(spec: mujoco.MjSpec, robot: Robot, drive: Drive) -> None:
    """Add the integral parts of a drive's motors, for MuJoCo without the callback.

    The current of a winding with resistance R and inductance L, under the voltage K w_wanted - K w of a motor of constant K,
    is a leaky integral: its torque has K_I = K^2 / L and K_dc = K^2 / R. Only the sum with the proportional part is limited.
    """
    limited, time = math.isfinite(drive.torque_limit), min(drive.dc_stiffness / drive.integral_gain, _LONGEST)
    most = drive.torque_limit if limited else 0.0
    for motor, wheels in robot.motors.items():
        stiffness = 0.5 * len(wheels) * drive.integral_gain * time
        winding = spec.add_actuator(name=f"{motor}_integral", target=motor, trntype=mujoco.mjtTrn.mjTRN_TENDON)
        winding.set_to_dcmotor([1.0, 1.0], 1.0 / stiffness, inductance=[0.0, time], ctrlspec=_VOLTAGE)
        for wheel in wheels:
            joint = spec.joint(f"{wheel}_wheel")
            joint.actfrclimited, joint.actfrcrange = limited, [-most, most]


def controls(model: mujoco.MjModel, references: FloatArray) -> FloatArray:
    """Return the (..., nu) inputs of all motors for (..., 2) wheel-rate references [rad/s] of the left and right side."""
    return references if model.nu == len(SIDES) else np.concatenate([references, references], axis=-1)


def set_motors(model: mujoco.MjModel, calibration: Calibration, drive: Drive, prefix: str = "") -> None:
    """Set the motors of `drive`, with the calibration's gain, on a compiled model, in place.

    Without `add_controllers` they have no integral part. A motor that turns one wheel of two has half of a side's numbers.
    `prefix` stands in front of the robot's names in a larger model.

    Raises:
        ValueError: another program's callback controls actuators in this process.
    """
    _install()
    dt, motor = calibration.timestep, motor_numbers(drive, calibration.timestep)
    lost = calibration.rolling_resistance * 0.5 * calibration.mass * GRAVITY * calibration.wheel_radius + motor.gear_loss
    model.dof_damping[robot_parts(model, prefix).dofs] = 0.5 * motor.braking
    limited = math.isfinite(motor.limit)
    for name, wheels in calibration.robot.motors.items():
        share, index = 0.5 * len(wheels), model.actuator(f"{prefix}{name}_motor").id
        gain, most = share * calibration.gain, share * motor.limit
        at = model.actuator_actadr[index], model.actuator_ctrladr[index], model.actuator_outadr[index]
        if model.actuator_dyntype[index] == mujoco.mjtDyn.mjDYN_USER:
            model.actuator_dynprm[index, :8] = *at, motor.leaked, share * motor.gained, most, gain, 1.0 / dt
            model.actuator_gainprm[index, 0] = 1.0
        else:
            model.actuator_gainprm[index, 0] = gain
        model.actuator_biasprm[index, :3] = 0.0, 0.0, share * motor.braking - gain
        model.actuator_forcelimited[index] = limited
        model.actuator_forcerange[index] = (-most, most) if limited else 0.0
        model.tendon_frictionloss[model.tendon(f"{prefix}{name}").id] = share * lost


@lru_cache(maxsize=1)
def _callback() -> Any:
    """Return the compiled callback; it is kept on disk under the offsets, which another version of MuJoCo may change."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(mass=1.0, inertia=[1.0, 1.0, 1.0]).add_joint(name="wheel")
    motor = spec.add_actuator(target="wheel", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.dyntype, motor.actdim = mujoco.mjtDyn.mjDYN_USER, 2
    model = spec.compile()
    data, numbers = mujoco.MjData(model), model.actuator_dynprm.shape[1]
    from_model = offset(model, model.actuator_dynprm)
    rest, change, control, rate = (offset(data, a) for a in (data.act, data.act_dot, data.ctrl, data.actuator_velocity))

    @compiled_for_c(types.float64(types.intp, types.intp, types.int32))
    def activations(model: int, data: int, actuator: int) -> float:
        """Set how both activations of a motor change; the integral part is stepped as `advance_integral` does it."""
        first, own = numbers * actuator, model + from_model
        at = int(number(own, first))
        wanted = number(data + control, int(number(own, first + 1)))
        error = wanted - number(data + rate, int(number(own, first + 2)))
        integral, set_point, most = number(data + rest, at), number(data + rest, at + 1), number(own, first + 5)
        later = integral + (number(own, first + 3) * integral + number(own, first + 4) * error)
        steps = number(own, first + 7)  # of a second
        set_number(data + change, at, (min(max(later, -most), most) - integral) * steps)
        set_number(data + change, at + 1, (number(own, first + 6) * wanted + integral - set_point) * steps)
        return 0.0  # of an actuator with one activation

    return activations.ctypes


def _install() -> None:
    """Give MuJoCo the callback.

    Raises:
        ValueError: it has another one.
    """
    with _INSTALLING:
        ours = _callback()
        if mujoco.get_mjcb_act_dyn() is None:
            mujoco.set_mjcb_act_dyn(ours)
    if mujoco.get_mjcb_act_dyn() != ours:
        raise ValueError("mujoco's mjcb_act_dyn is in use: another program controls actuators in this process")
