"""What MuJoCo's soft contact does under a tyre that skids: how high the tyre rides, and when it leaves the ground.

A contact with the depth delta has an impedance d(delta), and gives way by R = A (1 - d) / d for each newton, where A is the
contact's inverse mass (docs/physics.md, "Why the contact is soft"). A tyre of friction mu that slips at the speed s, with a
slip that grows at the rate a, under an elliptic cone, carries its load N where

    N R(delta) (1 + mu^2 / impratio) = k d(delta) delta + mu (b s + a)

The last term is the cone's: friction that cannot stop the slip at once also pushes the bodies apart. So the tyre rises with
slip speed, until at no depth the left side is too small; and a servo that jerks its wheels shakes the load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

_CLOSE = 1e-8
"""Last relative step of Newton's method for a depth, beyond which rounding remains."""


@dataclass(frozen=True)
class ContactLaw:
    """The contact of one tyre with level ground."""

    load: float
    """Load of the contact point at rest N [N]; half of the wheel's where a wheel has two."""
    inverse_mass: float
    """Inverse mass behind the contact A [1/kg], as MuJoCo takes it."""
    friction: float
    """Sliding friction mu [1]; the greater one of an anisotropic tyre."""
    solimp: tuple[float, float, float, float, float]
    """Impedance at no depth and at full depth [1], that depth [m], where between them the curve bends [1], its power [1]."""
    stiffness: float
    """k: reference acceleration over depth, at an impedance of one [1/s2]."""
    damping: float
    """Reference acceleration over the speed at which the tyre sinks in [1/s]."""
    slip_damping: float
    """b: reference acceleration over slip speed [1/s]."""
    cone: float
    """Slope of the cone as the solver has it, mu over the root of impratio [1]; of friction across the wheel, where the tyre
    is anisotropic."""

    @property
    def time_constant(self) -> float:
        """Time constant of the contact [s], `solref[0]`."""
        return 2.0 / (self.solimp[1] * self.damping)

    def impedance(self, depth: float) -> float:
        """Return d(depth) [1]: a curve of two power laws, from `solimp[0]` at the surface to `solimp[1]` at full depth."""
        return self._impedance(depth)[0]

    def _impedance(self, depth: float) -> tuple[float, float]:
        """Return d(depth) [1] and its slope [1/m]."""
        low, high, width, middle, power = self.solimp
        x = min(max(depth / width, 0.0), 1.0)
        if x == 1.0:
            return high, 0.0
        if power == 1.0:
            y, slope = x, 1.0
        elif x <= middle:
            slope = power * (x / middle) ** (power - 1.0)
            y = slope * x / power
        else:
            slope = power * ((1.0 - x) / (1.0 - middle)) ** (power - 1.0)
            y = 1.0 - slope * (1.0 - x) / power
        return low + y * (high - low), slope * (high - low) / width

    def _give(self, depth: float) -> float:
        """Return N R [m/s2]: what the load makes of the contact's softness at this depth."""
        d = self.impedance(depth)
        return self.load * self.inverse_mass * (1.0 - d) / d

    def depth(self, slip: float) -> float:
        """Return how deep a tyre of steady slip speed `slip` [m/s] is pressed in [m]; 0 where it leaves the ground."""
        sliding, push = 1.0 + self.cone**2 if slip > 0.0 else 1.0, self._push(slip)
        give, stiffness = sliding * self.load * self.inverse_mass, self.stiffness

        def excess(depth: float) -> tuple[float, float]:
            d, slope = self._impedance(depth)
            return stiffness * d * depth + push - give * (1.0 - d) / d, stiffness * (d + slope * depth) + give * slope / d**2

        if push > 0.0 and excess(0.0)[0] >= 0.0:
            return 0.0
        low, high, depth = 0.0, math.inf, 0.5 * self.solimp[2]
        while True:  # Newton's method, where that leaves the bracket a bisection
            value, slope = excess(depth)
            low, high = (low, depth) if value > 0.0 else (depth, high)
            step = value / slope
            if abs(step) <= _CLOSE * depth:
                return depth - step
            depth = depth - step if low < depth - step < high else min(0.5 * (low + high), 2.0 * depth)

    def _push(self, slip: float) -> float:
        return self.friction * self.slip_damping * slip

    def rise(self, slip: float) -> float:
        """Return how much higher a tyre of steady slip speed `slip` [m/s] rides than one that rolls [m]."""
        return self.depth(0.0) - self.depth(slip)

    @property
    def slip_limit(self) -> float:
        """Slip speed at which the tyre leaves the ground [m/s]; infinite without friction."""
        if self.friction * self.slip_damping == 0.0:
            return math.inf
        return (1.0 + self.cone**2) * self._give(0.0) / (self.friction * self.slip_damping)

    @property
    def reserve(self) -> float:
        """N R of the tyre at rest [m/s2]: what a growing slip's `mu a` has to be small beside."""
        return self._give(self.depth(0.0))

    @property
    def spring(self) -> float:
        """Slope over depth of what holds the tyre up, k d(delta) delta - N R(delta), at rest [1/s2]."""
        rest = self.depth(0.0)
        step = 1e-4 * rest
        held = [self.stiffness * self.impedance(d) * d - self._give(d) for d in (rest - step, rest + step)]
        return (held[1] - held[0]) / (2.0 * step)


def soft_contact(
    load: float, inverse_mass: float, solref: tuple[float, float], solimp: tuple[float, float, float, float, float]
) -> ContactLaw:
    """Return the law of a contact without friction, whose depth at rest is that of any friction.

    Args:
        load: load of the contact point [N].
        inverse_mass: inverse mass behind the contact [1/kg]: `body_invweight0` of the wheel.
        solref: time constant [s] and damping ratio [1], as MuJoCo has them.
        solimp: impedance, as MuJoCo has it.
    """
    greatest, (time, ratio) = solimp[1], solref
    stiffness, damping = 1.0 / (greatest * time * ratio) ** 2, 2.0 / (greatest * time)
    return ContactLaw(load, inverse_mass, 0.0, solimp, stiffness, damping, damping, 0.0)


def contact_law(model: mujoco.MjModel, data: mujoco.MjData, tires: Sequence[int]) -> ContactLaw:
    """Read the law off a robot at rest, at the contact point with the least reserve against slip.

    Args:
        model: the robot on its ground.
        data: its state at rest, stepped at least once.
        tires: ids of the contact geoms.

    Raises:
        ValueError: no tyre touches the ground, or the friction cone is pyramidal, for which the law does not hold.
    """
    if model.opt.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        raise ValueError("the law of ride height is that of an elliptic friction cone, not of a pyramidal one")
    laws = []
    for contact in data.contact[: data.ncon]:
        row = contact.efc_address
        if row < 0 or not set(contact.geom.tolist()) & set(tires):
            continue
        low, high, width, middle, power = map(float, contact.solimp)
        tangents = contact.solreffriction if contact.solreffriction.any() else contact.solref
        laws.append(
            ContactLaw(
                float(data.efc_force[row]), float(data.efc_diagA[row]), float(max(contact.friction[:2])),
                (low, high, width, middle, power), *_reference(contact.solref, high, model),
                _reference(tangents, high, model)[1], float(contact.mu),
            )
        )  # fmt: skip
    if not laws:
        raise ValueError("no tyre touches the ground")
    return min(laws, key=lambda law: law.slip_limit)


def _reference(solref: Sequence[float], greatest: float, model: mujoco.MjModel) -> tuple[float, float]:
    """Return k [1/s2] and b [1/s] of a contact's `solref`: a time constant and a damping ratio, or -k and -b themselves."""
    first, second = float(solref[0]), float(solref[1])
    if first <= 0.0:
        return -first / greatest**2, -second / greatest
    time = max(first, 2.0 * model.opt.timestep)  # MuJoCo's own safeguard
    return 1.0 / (greatest * time * second) ** 2, 2.0 / (greatest * time)
