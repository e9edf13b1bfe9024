"""Settings of contacts, solver and integrator that override those of models/husky.xml.

These are not calibrated: they say how the physics is computed, not which robot is meant. `robot_model` applies
them once, after the calibration, so what a fit moves and what a study of settings moves never meet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import mujoco

Cone = Literal["elliptic", "pyramidal"]
Solver = Literal["Newton", "CG", "PGS"]
Impedance = tuple[float, float, float, float, float]
Integrator = Literal["Euler", "implicit", "implicitfast", "RK4"]


@dataclass(frozen=True)
class PhysicsSettings:
    """Overrides; None leaves what is shipped."""

    cone: Cone | None = None
    """Shape of the friction cone -> opt.cone."""
    impratio: float | None = None
    """Impedance of friction over that of the normal [1] -> opt.impratio."""
    noslip: int | None = None
    """Iterations of the solver that takes the softness out of friction afterwards -> opt.noslip_iterations."""
    condim: int | None = None
    """3: sliding friction; 4: torsional besides; 6: rolling besides -> geom_condim, pair_dim."""
    solimp: Impedance | None = None
    """Impedance of tyre on ground: at no depth, at full depth [1], that depth [m], its midpoint and power [1]."""
    solref: tuple[float, float] | None = None
    """Time constant [s] and damping ratio [1] of tyre on ground."""
    solver: Solver | None = None
    """Constraint solver -> opt.solver."""
    iterations: int | None = None
    """Greatest number of solver iterations -> opt.iterations."""
    integrator: Integrator | None = None
    """Integrator -> opt.integrator."""
    tangent_ratio: float | None = None
    """Friction along MuJoCo's first tangent over that along its second [1] -> pair_friction. On every shape but the capsule
    the tangents are the world's axes, which no tyre knows of; a robot's own is `Calibration.friction_ratio`."""

    def __post_init__(self) -> None:
        """Refuse numbers that MuJoCo has no meaning for."""
        for name in ("impratio", "tangent_ratio"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}, must be positive")
        for name, least in (("noslip", 0), ("iterations", 1)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise ValueError(f"{name} is {value}, must be at least {least}")
        if self.condim not in (None, 3, 4, 6):
            raise ValueError(f"condim is {self.condim}, must be 3, 4 or 6: a tyre without friction drives nowhere")


SHIPPED = PhysicsSettings()
"""models/husky.xml as it is."""


def apply_settings(model: mujoco.MjModel, settings: PhysicsSettings, tires: Sequence[int]) -> None:
    """Set the overrides on a compiled and calibrated model, in place; `tires` are the ids of the contact geoms."""
    import mujoco  # slow to import; whoever only names settings does not need it

    for name, value in (
        ("cone", settings.cone and getattr(mujoco.mjtCone, f"mjCONE_{settings.cone.upper()}")),
        ("solver", settings.solver and getattr(mujoco.mjtSolver, f"mjSOL_{settings.solver.upper()}")),
        ("integrator", settings.integrator and getattr(mujoco.mjtIntegrator, f"mjINT_{settings.integrator.upper()}")),
        ("impratio", settings.impratio),
        ("noslip_iterations", settings.noslip),
        ("iterations", settings.iterations),
    ):
        if value is not None:
            setattr(model.opt, name, value)
    for name, numbers in (("condim", settings.condim), ("solimp", settings.solimp), ("solref", settings.solref)):
        if numbers is not None:
            getattr(model, f"geom_{name}")[list(tires)] = numbers
            getattr(model, "pair_dim" if name == "condim" else f"pair_{name}")[:] = numbers
    if settings.tangent_ratio is not None:
        model.pair_friction[:, 0] = settings.tangent_ratio * model.pair_friction[:, 1]
