"""The functions of libode 0.16 that this project calls, bound by ctypes: no compiler is needed.

The layout of its structures is that of ode/contact.h, ode/mass.h and ode/common.h of ODE 0.16 in
double precision.
"""

from __future__ import annotations

import ctypes as c
from functools import cache
from typing import Any, ClassVar

from validation.engines.body import EngineMissingError

NAMES = ("libode.so.8", "libode.8.dylib")
"""Names of the library's file; the number is that of its binary interface, which all versions 0.16
share."""
_HOW_TO_GET_ODE = (
    "ODE is missing: install libode 0.16 (Debian, Ubuntu: apt install libode8), "
    "and compare without it until then"
)
"""Line that says how to get it."""
# Parameters of motors: `dParamVel`, `dParamFMax`.
VEL = 2
F_MAX = 5
# Flags of a contact.
MU2 = 0x001
FDIR1 = 0x002
SOFT_ERP = 0x008
SOFT_CFM = 0x010
SLIP2 = 0x200
APPROX1 = 0x7000
"""Flag without which the friction of a contact would be a force [N]."""

_D = c.c_double
_I = c.c_int
_P = c.c_void_p
Vector = _D * 4
"""`dVector3`: three numbers and one for alignment; `dQuaternion`, w first."""


class Mass(c.Structure):
    """`dMass`."""

    _fields_ = (("mass", _D), ("centre", Vector), ("inertia", _D * 12))


class ContactGeom(c.Structure):
    """`dContactGeom`."""

    _fields_ = (
        *(("pos", Vector), ("normal", Vector), ("depth", _D)),
        *(("geom1", _P), ("geom2", _P), ("side1", _I), ("side2", _I)),
    )


_SURFACE = ("mu", "mu2", "rho", "rho2", "rho_n", "bounce", "bounce_vel", "soft_erp", "soft_cfm")
_MOTION = ("motion1", "motion2", "motion_n", "slip1", "slip2")


class Contact(c.Structure):
    """`dContact` with the fields of its `dSurfaceParameters`."""

    _fields_: ClassVar[list[Any]] = [
        ("mode", _I),
        *((n, _D) for n in (*_SURFACE, *_MOTION)),
        ("geom", ContactGeom),
        ("fdir1", Vector),
    ]


class JointFeedback(c.Structure):
    """`dJointFeedback`: force and torque on both bodies."""

    _fields_ = (("f1", Vector), ("t1", Vector), ("f2", Vector), ("t2", Vector))


_SIGNATURES = {
    "dInitODE2 dAllocateODEDataForThread": (_I, [c.c_uint]),
    "dRandSetSeed": (None, [c.c_ulong]),
    "dWorldCreate": (_P, []),
    "dWorldDestroy dGeomDestroy dJointGroupEmpty dJointGroupDestroy": (None, [_P]),
    "dWorldSetERP dWorldSetCFM dWorldSetContactMaxCorrectingVel "
    "dWorldSetContactSurfaceLayer dWorldSetQuickStepW "
    "dJointAddHingeTorque": (None, [_P, _D]),
    "dWorldSetQuickStepNumIterations dBodySetGyroscopicMode dJointSetAMotorNumAxes": (
        None,
        [_P, _I],
    ),
    "dWorldStep dWorldQuickStep": (_I, [_P, _D]),
    "dMassSetParameters": (None, [c.POINTER(Mass), *[_D] * 10]),
    "dBodyCreate": (_P, [_P]),
    "dBodySetMass": (None, [_P, c.POINTER(Mass)]),
    "dWorldSetGravity dBodySetPosition dBodySetLinearVel dBodySetAngularVel "
    "dBodyAddTorque dJointSetHingeAnchor "
    "dJointSetHingeAxis": (None, [_P, _D, _D, _D]),
    "dBodySetQuaternion dGeomSetOffsetQuaternion": (None, [_P, Vector]),
    "dBodyGetPosition dBodyGetQuaternion dBodyGetLinearVel dBodyGetAngularVel dBodyGetRotation": (
        c.POINTER(_D),
        [_P],
    ),
    "dGeomSetBody": (None, [_P, _P]),
    "dCreatePlane": (_P, [_P, _D, _D, _D, _D]),
    "dCreateSphere": (_P, [_P, _D]),
    "dCreateCylinder": (_P, [_P, _D, _D]),
    "dCollide": (_I, [_P, _P, _I, _P, _I]),
    "dJointGroupCreate": (_P, [_I]),
    "dJointCreateContact": (_P, [_P, _P, c.POINTER(Contact)]),
    "dJointCreateHinge dJointCreateAMotor": (_P, [_P, _P]),
    "dJointAttach": (None, [_P, _P, _P]),
    "dJointSetFeedback": (None, [_P, c.POINTER(JointFeedback)]),
    "dJointSetHingeParam dJointSetAMotorParam": (None, [_P, _I, _D]),
    "dJointSetAMotorAxis": (None, [_P, _I, _I, _D, _D, _D]),
}
"""Types of what functions return and take, by the functions' names."""


@c.CFUNCTYPE(None, _I, c.c_char_p, _P)
def _ignore_message(number: int, text: bytes, arguments: int) -> None:
    """Ignore a message of the library, which would write it to standard error otherwise."""


@cache
def load_ode() -> c.PyDLL:
    """Return the library, with the types of its functions set.

    Its calls are short, and some change state that all worlds share, so they keep Python's lock.

    Raises:
        EngineMissingError: it is not there, or is one of single precision.
    """
    for name in NAMES:
        try:
            library = c.PyDLL(name)
            break
        except OSError:
            continue
    else:
        raise EngineMissingError(_HOW_TO_GET_ODE)
    library.dGetConfiguration.restype = c.c_char_p
    if b"ODE_double_precision" not in library.dGetConfiguration().split():
        raise EngineMissingError(
            f"{_HOW_TO_GET_ODE}; the one that is installed is of single precision"
        )
    for names, (result, arguments) in _SIGNATURES.items():
        for name in names.split():
            function = getattr(library, name)
            function.restype = result
            function.argtypes = arguments
    library.dSetMessageHandler(_ignore_message)
    library.dInitODE2(0)
    return library
