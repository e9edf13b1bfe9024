"""Declaration of a planar model: its parameter set, and the compiled law of its velocities.

A new model is a file beside this one, named like the model, and a name in `PLANAR_MODELS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

from ssmr._jit import built_in
from ssmr.parameters import numbers_of, require_one_of
from ssmr.robot.drive import Motor, Sides
from ssmr.robot.vehicle import Vehicle

PLANAR_MODELS = ("improved", "coulomb", "linear", "kinematic")
"""Names of the planar models, in the order of tables. A model's file is imported, and compiled,
when it is first used."""


class PlanarRobot(NamedTuple):
    """All numbers of a planar robot, for compiled functions."""

    vehicle: Any  # the `VehicleBody`
    # numbers of the model's own parameter set; their type decides which law is compiled in
    parameters: Any
    motor: Motor  # the motor of a side
    # longitudinal coordinate of the centre of rotation at rest [m]: v_y = -(x_ICR + k v) omega (Eq.
    # 2.10)
    x_icr: float
    drift: float  # its shift with speed, k [s]
    ideal: bool  # whether the wheels turn exactly at their references, see `PlanarLaw.ideal`
    dt: float  # physics step [s]
    constants: Any  # what `PlanarLaw.constants` returned


Advanced = tuple[float, float, Sides]
"""Forward speed [m/s] and yaw rate [rad/s] after a step, and the torques of both sides at its start
[N m]."""
Advance = Callable[[float, float, Sides, Sides, float, PlanarRobot], Advanced]
"""One step of the velocities: v [m/s], omega [rad/s], the motor controllers' references [rad/s] and
the integral parts of their torques [N m], disturbing yaw acceleration [rad/s2] and the robot's
numbers give what `Advanced` says."""


@dataclass(frozen=True, eq=False)
class PlanarLaw:
    """A planar model."""

    name: str
    """Name of the model, and of its file."""
    parameters: type
    """Frozen dataclass of the model's parameters, declared with `ssmr.parameters.parameter`."""
    advance: Advance
    """Compiled function that advances the velocities by one step."""
    rotation_centre: Callable[[Vehicle, Any], float] = lambda vehicle, parameters: 0.0
    """Function of vehicle and parameters that returns x_ICR [m]; 0 by default (Sec. 2.2.3)."""
    constants: Callable[[Any, Any, float], Any] = lambda body, parameters, dt: parameters
    """Function of the `VehicleBody`, the packed parameters and the physics step [s]. It returns, as
    a tuple of numbers, what the law would otherwise derive at every step: reciprocals,
    exponentials. A step is fast without divisions. A law that derives nothing has its parameters
    once more."""
    vehicle: tuple[str, ...] = (
        "mass",
        "yaw_inertia",
        "wheel_radius",
        "radius_difference",
        "effective_half_track",
    )
    """Fields of the vehicle that a fit may move: those that the law uses and that no scale or
    tape measures surely."""
    colour: str = "#808080"
    """Colour in pictures and recordings, as #rrggbb."""
    ideal: bool = False
    """Whether the wheels turn exactly at their references. Otherwise their rates follow from the
    body's motion (Eq. 2.9)."""
    drift: Callable[[Any], float] = lambda parameters: 0.0
    """Function of the parameters that returns the outward drift k [s] of v_y = -(x_ICR + k v)
    omega; the thesis has none."""

    def __post_init__(self) -> None:
        """Register the law for robots and compiled functions, which find it by types."""
        _LAWS[self.parameters] = self
        numbers_of(self.parameters)._advance = self.advance


OWN_MODELS: dict[str, PlanarLaw] = {}
"""Planar models of the user's own by name, which this process knows beside `PLANAR_MODELS`."""
_LAWS: dict[type, PlanarLaw] = {}


def planar_law(name: str) -> PlanarLaw:
    """Return the planar model of a name: the `LAW` of its file.

    Raises:
        ValueError: there is no such model; the message lists the names.
    """
    if name in OWN_MODELS:
        return OWN_MODELS[name]
    require_one_of(name, PLANAR_MODELS, f"unknown planar model '{name}'")
    law: PlanarLaw = import_module(f"ssmr.models.{name}").LAW
    return law


def law_of(parameters: object) -> PlanarLaw:
    """Return the model that a parameter set belongs to.

    Raises:
        ValueError: it belongs to none.
    """
    law = _LAWS.get(type(parameters))
    if law is None:
        raise ValueError(f"{type(parameters).__name__} is the parameter set of no planar model")
    return law


@built_in
def advance(
    typing: Any, v: Any, w: Any, wheels: Any, integral: Any, disturbance: Any, robot: Any
) -> Any:
    """Advance the velocities of any planar robot by its law; for compiled functions only.

    The law is chosen when a loop is compiled: every model gets one of its own, without a branch at
    run time.
    """
    numbers = robot.types[robot.fields.index("parameters")]
    law = numbers.instance_class._advance._numba_type_
    given = (v, w, wheels, integral, disturbance, robot)

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_function(law, signature)(builder, arguments)

    return typing.resolve_function_type(law, given, {}), build
