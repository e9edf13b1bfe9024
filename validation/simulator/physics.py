"""Settings of physics: the constraint solver, MuJoCo's stopwatch, and overrides of a robot's MJCF.

These are not calibrated: they say how the physics is computed, not which robot is meant.
`robot_model` applies them once, after the calibration, so a fit and a study of settings never
move the same number.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import mujoco

Cone = Literal["elliptic", "pyramidal"]
Solver = Literal["Newton", "CG", "PGS"]
Impedance = tuple[float, float, float, float, float]
Integrator = Literal["Euler", "implicit", "implicitfast", "RK4"]


@dataclass(frozen=True)
class PhysicsSettings:
    """Overrides; None leaves the shipped value."""

    cone: Cone | None = None
    """Shape of the friction cone -> opt.cone."""
    impratio: float | None = None
    """Impedance of friction over that of the normal [1] -> opt.impratio."""
    solimp: Impedance | None = None
    """Impedance of tyre on ground: at no depth, at full depth [1], that depth [m], its midpoint and
    power [1]."""
    solref: tuple[float, float] | None = None
    """Time constant [s] and damping ratio [1] of tyre on ground."""
    solver: Solver | None = None
    """Constraint solver -> opt.solver; None for the one that `_solver_for` chooses."""
    tolerance: float | None = None
    """Tolerance of the constraint solver for a robot of `_LIGHT` or more [1] -> opt.tolerance; None
    for that of `SOLVING`."""
    iterations: int | None = None
    """Greatest number of solver iterations -> opt.iterations; None for those of `SOLVING`."""
    integrator: Integrator | None = None
    """Integrator -> opt.integrator."""


MUJOCO_IMPEDANCE: Impedance = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's default `solimp`."""
SHIPPED = PhysicsSettings()
"""A robot's MJCF as it is, solved as `_solver_for` says."""
SEARCHING = PhysicsSettings(tolerance=1e-7)
"""The same solved less exactly, while a fit searches with longer steps and never for results: after
a minute a Husky is within 0.5 mm of where it would be, in five sixths of the time."""

SOLVING: Mapping[Solver, tuple[float, int]] = {
    "CG": (3e-10, 400),
    "Newton": (1e-10, 50),
    "PGS": (1e-10, 50),
}
"""Tolerance and greatest number of iterations of each solver. Conjugate gradients take few
iterations in the mean and some hundreds in some: stopped at 200, they move a Jackal's path by 0.2
mm."""
_LIGHT = 51.0
"""Mass below which the tolerance falls with the mass [kg]; measured, not derived. On trajectory 4
a tolerance of 3e-10 leaves up to 0.003 mm of a path of a Husky or a Warthog and 0.24 mm of a
Jackal's, of 17 kg; 1e-10 leaves 0.02 mm of that."""
_EASY_RATIO = 0.5
"""Friction across a wheel over that along it down to which conjugate gradients converge well: from
0.2 on they do not."""


def _solver_for(settings: PhysicsSettings, friction_ratio: float) -> Solver:
    """Return the constraint solver of a model.

    Conjugate gradients solve the shipped physics in 0.87 (Husky) to 1.06 (Warthog) of Newton's
    time, and their paths and Newton's are the same within 0.05 mm. Newton's method copes with all
    else: with much less friction across the wheels than along them, and with whatever contacts,
    cones and integrators a study tries.
    """
    if settings.solver is not None:
        return settings.solver
    usual = replace(settings, tolerance=None) == SHIPPED
    return "CG" if usual and friction_ratio >= _EASY_RATIO else "Newton"


def apply_settings(
    model: mujoco.MjModel,
    settings: PhysicsSettings,
    tires: Sequence[int],
    friction_ratio: float = 1.0,
) -> None:
    """Set solver and overrides on a compiled and calibrated model, in place.

    Args:
        model: the model.
        settings: overrides.
        tires: ids of the contact geoms.
        friction_ratio: friction across a wheel over that along it [1].
    """
    import mujoco  # slow to import; whoever only names settings does not need it

    solver = _solver_for(settings, friction_ratio)
    tolerance, iterations = SOLVING[solver]
    # All wheels hang on one body: there is one island, and looking for more costs time.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    option = model.opt
    option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver.upper()}")
    option.tolerance = (settings.tolerance or tolerance) * min(
        1.0, mujoco.mj_getTotalmass(model) / _LIGHT
    )
    option.iterations = settings.iterations or iterations
    option.impratio = settings.impratio or option.impratio
    if settings.cone is not None:
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{settings.cone.upper()}")
    if settings.integrator is not None:
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{settings.integrator.upper()}")
    for name, numbers in (("solimp", settings.solimp), ("solref", settings.solref)):
        if numbers is not None:
            getattr(model, f"geom_{name}")[list(tires)] = numbers
            getattr(model, f"pair_{name}")[:] = numbers


def stop_the_stopwatch() -> None:
    """Give MuJoCo a clock that stands still, unless somebody has given it one already.

    MuJoCo reads the clock some thirty times a step to tell in `mjData.timer` where the time went.
    Nobody here asks for that, and it takes a twelfth of a step.
    """
    import mujoco

    if mujoco.get_mjcb_time() is None:
        # in C, without the interpreter
        constant = ctypes.CFUNCTYPE(ctypes.c_double)(("PyFloat_GetMin", ctypes.pythonapi))
        mujoco.set_mjcb_time(constant)
