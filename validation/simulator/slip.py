"""Tyres that slip as they roll, inside MuJoCo: the law of `ssmr.models.friction`, in the place of Coulomb's.

A rolling tyre's force grows with its slip, the sliding speed over the rolling one, until all of its contact slides. MuJoCo's
contact knows sliding speed only. A compiled callback, which MuJoCo calls when it has made its constraints, therefore makes
each tyre's friction a damper: its coefficient is the brush law's force over the sliding speed at the beginning of the step,
and the solver finds the force from the speed at the end of the step. So a step of any length is stable, steady forces are
exactly the law's, and the callback remembers nothing from step to step.
"""

from __future__ import annotations

import ctypes
import math
import threading
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numba import types

from ssmr._jit import compiled_for_c
from ssmr.models.friction import AlongAcross, Tyre, tyre_force
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY
from validation.simulator.memory import address, integer, number, offset, set_number
from validation.simulator.parts import robot_parts

_NUMERIC = "slip"
_MARK = 1.7320508075688772e-211
"""First of the numbers of a model whose tyres slip: the callback leaves all other models alone."""
LEAST_ROLLING = 0.005
"""Rolling speed below which slip is sliding speed over this one, over sqrt(wheel radius x g) [1]: a standing tyre creeps."""
_SLACK = 3.0
"""The solver's friction cone over the tyre's: the law itself limits the force, the cone only what a sudden step asks for."""
_BODY, _DOFS = 6, 10
"""Degrees of freedom of the robot's body, and with those of the wheels, which follow."""
_INSTALLING = threading.Lock()


def add_slip(spec: mujoco.MjSpec) -> None:
    """Give a robot a place for the numbers of its tyres, which `set_slip` sets on the compiled model."""
    spec.add_numeric(name=_NUMERIC, size=5)


def set_slip(model: mujoco.MjModel, calibration: Calibration, prefix: str = "") -> None:
    """Set how the tyres of a compiled and calibrated model slip, in place; its contacts have Coulomb's friction before.

    `prefix` stands in front of the robot's names in a larger model, which has no other joints.

    Raises:
        ValueError: the model has no place for these numbers, or another program's callback adds passive forces.
    """
    place = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, f"{prefix}{_NUMERIC}")
    if place >= 0:
        model.numeric_data[model.numeric_adr[place] :][:5] = 0.0
    if calibration.slip_compliance == 0.0:
        return
    if place < 0 or model.numeric_adr[place] != 0 or model.nv != _DOFS:
        raise ValueError(
            f"slip_compliance {calibration.slip_compliance:g}: MuJoCo alone has no tyres that slip as they roll; "
            "with 0 they have Coulomb's friction"
        )
    _install()
    least = LEAST_ROLLING * math.sqrt(GRAVITY * calibration.wheel_radius)
    numbers = _MARK, calibration.friction, 1.0 / calibration.slip_compliance, least, 1.0 / calibration.timestep
    model.numeric_data[:5] = numbers
    model.geom_friction[robot_parts(model, prefix).tires, 0] *= _SLACK
    model.pair_friction[:, :2] *= _SLACK
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE


@lru_cache(maxsize=1)
def _callback() -> Any:
    """Return the compiled callback; it is kept on disk under the offsets, which another version of MuJoCo may change.

    Raises:
        ValueError: this version of MuJoCo lays its data out in a way that is not known here.
    """
    model, data = _two_balls()
    rows, from_model = _rows_at(model, data), offset(model, model.numeric_data)
    arrays = data.efc_J, data.efc_R, data.efc_D, data.efc_KBIP, data.efc_pos, data.efc_margin, data.qvel, data.efc_type
    jacobian, softness, hardness, reference, depth, margin, rates, kind = (offset(data, array) for array in arrays)
    contacts, identity = kind - 8, offset(data, data.efc_id)
    first, each = data.contact.dist.ctypes.data, data.contact.mu.strides[0] // 8
    if ctypes.c_size_t.from_address(data._address + contacts).value != first:
        raise ValueError(f"mujoco {mujoco.__version__} keeps its contacts in another place: here slip_compliance must be 0")
    master, grip = ((part.ctypes.data - first) // 8 for part in (data.contact.mu, data.contact.friction))
    elliptic, mark, body, dofs = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC), _MARK, _BODY, _DOFS

    @compiled_for_c(types.void(types.intp, types.intp))
    def slip(model: int, data: int) -> None:
        """Make the friction of each tyre that touches the ground a damper of the brush law."""
        own = model + from_model
        if number(own, 0) != mark:
            return
        friction, stiffness, least, often = number(own, 1), number(own, 2), number(own, 3), number(own, 4)
        tyre = Tyre(friction, stiffness, stiffness, 1.0, 0.0)
        count, kinds, i = integer(data + rows), address(data + kind), 0
        while i < count:
            if integer(kinds + 4 * i) != elliptic:
                i += 1
                continue
            nearing, ahead, aside, rolled_ahead, rolled_aside = 0.0, 0.0, 0.0, 0.0, 0.0
            turned_ahead, turned_aside = 0.0, 0.0  # what turns with the robot: all but the velocity of its body
            for k in range(dofs):
                rate = number(data + rates, k)
                nearing += number(data + jacobian, dofs * i + k) * rate
                along = number(data + jacobian, dofs * (i + 1) + k) * rate
                across = number(data + jacobian, dofs * (i + 2) + k) * rate
                ahead, aside = ahead + along, aside + across
                if k >= 3:
                    turned_ahead, turned_aside = turned_ahead + along, turned_aside + across
                if k >= body:
                    rolled_ahead, rolled_aside = rolled_ahead + along, rolled_aside + across
            spring = number(data + reference, 4 * i) * number(data + reference, 4 * i + 2)
            over = number(data + depth, i) - number(data + margin, i)
            pushing = -(spring * over + number(data + reference, 4 * i + 1) * nearing)
            load = max(pushing * number(data + hardness, i), 0.0)
            rolling, sliding = max(math.hypot(rolled_ahead, rolled_aside), least), math.hypot(ahead, aside)
            tiny = max(sliding, 1e-9 * least)
            damping = max(-tyre_force(AlongAcross(tiny / rolling, 0.0), load, tyre).x / tiny, 1e-6)
            for j in range(1, 3):
                set_number(data + hardness, i + j, damping / often)
                set_number(data + softness, i + j, often / damping)
                set_number(data + reference, 4 * (i + j) + 1, often)
                set_number(data + reference, 4 * (i + j), 1.0)
                set_number(data + reference, 4 * (i + j) + 2, 1.0)
            turning = number(data + rates, 5)
            set_number(data + depth, i + 1, number(data + margin, i + 1) - turning * turned_aside)
            set_number(data + depth, i + 2, number(data + margin, i + 2) + turning * turned_ahead)
            contact = integer(address(data + identity) + 4 * i)
            cone = number(data + contacts, each * contact + grip)
            mixed = cone * math.sqrt(often / damping * number(data + hardness, i))
            set_number(data + contacts, each * contact + master, mixed)
            i += 3

    return slip.ctypes


def _two_balls() -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    spec.option.cone, spec.option.jacobian = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtJacobian.mjJAC_DENSE
    spec.add_numeric(name=_NUMERIC, size=1)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
    for x in (0.0, 1.0):
        ball = spec.worldbody.add_body(pos=[x, 0.0, 0.09])
        ball.add_freejoint()
        ball.add_geom(size=[0.1, 0.0, 0.0])
    model = spec.compile()
    return model, mujoco.MjData(model)


def _rows_at(model: mujoco.MjModel, data: mujoco.MjData) -> int:
    """Return where MuJoCo's data hold the number of constraint rows [bytes]; the last state touches the ground twice."""
    before = offset(data, data.qvel)
    places: list[set[int]] = []
    for heights in ((0.09, 1.0), (1.0, 1.0), (0.09, 0.09)):
        data.qpos[[2, 9]] = heights
        mujoco.mj_forward(model, data)
        words = np.ctypeslib.as_array(ctypes.cast(data._address, ctypes.POINTER(ctypes.c_int32)), (before // 4,))
        places.append(set(np.flatnonzero(words == data.nefc).tolist()))
    (place,) = set.intersection(*places)
    return 4 * place


def _install() -> None:
    """Give MuJoCo the callback.

    Raises:
        ValueError: it has another one.
    """
    with _INSTALLING:
        ours = _callback()
        if mujoco.get_mjcb_passive() is None:
            mujoco.set_mjcb_passive(ours)
    if mujoco.get_mjcb_passive() != ours:
        raise ValueError("mujoco's mjcb_passive is in use: another program adds forces in this process")
