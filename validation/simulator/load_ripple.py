"""How far a servo that follows a staircase of references shakes the wheel loads, and which number would calm it.

The driver gives a new wheel-rate reference every `hold` seconds. At each jump the servo pulls. The solver sees that pull
before the servo's own damping, and the friction cone makes a lift of it (`contact_law`): u = mu r dOmega/dt. The loads' sum
answers with the share u / (g + reserve) of the weight until the body has risen; then the contact, a spring with damping,
takes that back. Over the harmonics q of the staircase, with omega = 2 pi q / hold and z = exp(i omega dt), that is

    u_q = mu r jump (dt / hold) (K / 2J) L(z) / (1 - (1 - p) / z),   p = dt / (2J/K + dt)
    ripple^2 / (m g)^2 = (PHASE_SHARE / (g + reserve))^2 sum_q 2 |u_q omega^2 / (spring' - omega^2 + i damping' omega)|^2

with the transfer function L of the reference's lag and of the driver's ramp from one command to the next, and the contact's
spring' and damping' times g / (g + reserve). So the ripple grows with mu r jump over the longest of the times dt, 2J/K, the
lag and the ramp; and with K, where 2J/K is shorter than dt. A ramp from command to command leaves no staircase.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from validation.simulator.contact_law import ContactLaw
from validation.simulator.model import GRAVITY

PHASE_SHARE = 0.5
"""Share of the lift that the four wheels have in common [1]: a tyre slips only partly along its wheel, and slip grows on one
side where it shrinks on the other. Trajectories 1 and 4 with 16 sets of numbers, of which the calmest trembled by 0.1 % of
the weight and the worst by 87 %, gave 0.32 to 0.83."""
REACH = 10.0
"""Greatest factor by which a number is advised to be changed [1]."""
HALVINGS = 20
"""Halvings of that factor's logarithm: to five digits."""


@dataclass(frozen=True)
class RippleLaw:
    """The numbers of servo, reference and contact that decide how the loads' sum trembles."""

    contact: ContactLaw
    """The contact of a tyre."""
    wheel_radius: float
    """Rolling radius [m]."""
    gain: float
    """Gain K of a side's servo [N m s/rad]."""
    armature: float
    """Rotor inertia of a wheel through the gearbox [kg m2]."""
    wheel_inertia: float
    """Inertia of the wheel itself about its axle [kg m2]; J is the sum of both."""
    lag: float
    """Time constant of the reference behind the driver [s]."""
    hold: float
    """Time from one jump of the driver's reference to the next [s]."""
    ramp: float
    """Time that the driver takes for such a jump [s]; a ramp as long as `hold` leaves no staircase."""
    timestep: float
    """Physics step [s]."""

    @property
    def servo_time(self) -> float:
        """Time constant 2J/K with which a side's wheels follow their reference [s]."""
        return 2.0 * (self.armature + self.wheel_inertia) / self.gain

    def share(self, jump: float) -> float:
        """Return the root mean square of the loads' sum about the weight, over the weight [1].

        Args:
            jump: root mean square of the jumps of a side's reference from one hold to the next [rad/s].
        """
        dt, contact = self.timestep, self.contact
        omega = 2.0 * math.pi / self.hold * np.arange(1, max(2, int(0.5 * self.hold / dt) + 1))
        back = np.exp(-1j * omega * dt)  # 1 / z
        follows = dt / (self.servo_time + dt)
        pull = jump * self.wheel_radius * (dt / self.hold) / self.servo_time / (1.0 - (1.0 - follows) * back)
        if self.lag > 0.0:
            part = -math.expm1(-dt / self.lag)
            pull = pull * part / (1.0 - (1.0 - part) * back)
        if (steps := round(self.ramp / dt)) > 1:
            pull = pull * (1.0 - back**steps) / (steps * (1.0 - back))
        softened = GRAVITY / (GRAVITY + contact.reserve)
        answer = omega**2 / (softened * (contact.spring + 1j * contact.damping * omega) - omega**2)
        lift = contact.friction * np.abs(pull * answer)
        return float(PHASE_SHARE / (GRAVITY + contact.reserve) * np.sqrt(2.0 * np.sum(lift**2)))

    def remedies(self, ratio: float) -> tuple[tuple[str, RippleLaw], ...]:
        """Return what would bring the ripple down to `ratio` times its size, each alone, the one with the least harm first.

        A lag makes the robot late, a short time constant asks for small steps, a low gain droops, and an armature is heavy.

        Returns:
            For each number that can do it by a factor of at most `REACH`: the advice in words, and the law that follows it.
            A ramp comes before all of them.
        """
        aim = ratio * self.share(1.0)
        found: list[tuple[str, RippleLaw]] = []
        if self.ramp < self.hold:
            advice = f"let the driver go over to each command within {1e3 * self.hold:.0f} ms (command_ramp)"
            found.append((advice, replace(self, ramp=self.hold)))
        for change, words in _CHANGES:
            if (factor := _least_factor(self, change, aim)) is not None:
                then = change(self, factor)
                found.append((words(self, then), then))
        return tuple(found)


Change = Callable[[RippleLaw, float], RippleLaw]
"""Returns the law with one of its numbers changed by a factor above one, towards less ripple."""


def _with_gain(law: RippleLaw, factor: float) -> RippleLaw:
    return replace(law, gain=law.gain / factor)


def _with_armature(law: RippleLaw, factor: float) -> RippleLaw:
    return replace(law, armature=factor * (law.armature + law.wheel_inertia) - law.wheel_inertia)


def _with_lag(law: RippleLaw, factor: float) -> RippleLaw:
    return replace(law, lag=factor * max(law.lag, law.timestep))


def _with_contact_time(law: RippleLaw, factor: float) -> RippleLaw:
    c = law.contact
    factor = max(1.0, min(factor, c.time_constant / (2.0 * law.timestep)))  # MuJoCo takes no shorter time constant
    return replace(law, contact=replace(c, stiffness=factor**2 * c.stiffness, damping=factor * c.damping))


def _gain_words(now: RippleLaw, then: RippleLaw) -> str:
    return f"lower the gain from {now.gain:.0f} to about {then.gain:.0f} N m s/rad"


def _armature_words(now: RippleLaw, then: RippleLaw) -> str:
    heavier = 4.0 * (then.armature - now.armature) / now.wheel_radius**2
    return (
        f"raise the armature from {now.armature:.2f} to about {then.armature:.2f} kg m2 "
        f"(the robot is {heavier:.0f} kg heavier to push then)"
    )


def _lag_words(now: RippleLaw, then: RippleLaw) -> str:
    return f"let the reference lag by about {1e3 * then.lag:.0f} ms instead of {1e3 * now.lag:.0f}"


def _contact_words(now: RippleLaw, then: RippleLaw) -> str:
    before, after = 1e3 * now.contact.time_constant, 1e3 * then.contact.time_constant
    return f"shorten the contact's time constant from {before:.0f} to about {after:.0f} ms with its damping of slip as it is"


_CHANGES: tuple[tuple[Change, Callable[[RippleLaw, RippleLaw], str]], ...] = (
    (_with_lag, _lag_words),
    (_with_contact_time, _contact_words),
    (_with_gain, _gain_words),
    (_with_armature, _armature_words),
)


def _least_factor(law: RippleLaw, change: Change, aim: float) -> float | None:
    """Return the least factor of a change that brings `share` down to `aim`; None if none up to `REACH` does."""

    def enough(factor: float) -> bool:
        return change(law, factor).share(1.0) <= aim

    low, high = 1.0, REACH
    if not enough(high):
        return None
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high
