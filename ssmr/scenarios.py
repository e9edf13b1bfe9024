"""The four sample trajectories of the thesis as commands (Sec. 3.5.2, Tab. 3.6).

Constant linear velocity; once the robot is up to speed, a sine of yaw rate. The thesis gives
neither the duration nor the lead-in: 20 s and 2 s are our choice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssmr.types import Commands

COMMAND_PERIOD = 0.05
"""Period of the command input [s]; Tab. 3.5, 20 Hz."""


@dataclass(frozen=True)
class SineScenario:
    """u_cmd constant, omega_cmd = A sin(2 pi f (t - lead_in)) from t = lead_in on."""

    frequency: float
    """f [Hz]."""
    amplitude: float
    """A [rad/s] (printed in m)."""
    speed: float = 0.5
    """u_cmd [m/s]."""
    duration: float = 20.0
    """Length of the run [s]; not in the thesis."""
    lead_in: float = 2.0
    """Straight driving before the sine [s]; not in the thesis."""

    def commands(self) -> Commands:
        """Return the commands, sampled at 20 Hz."""
        n = round(self.duration / COMMAND_PERIOD)
        t = np.arange(n) * COMMAND_PERIOD
        phase = 2.0 * math.pi * self.frequency * (t - self.lead_in)
        sine = self.amplitude * np.sin(phase)
        yaw_rate = np.where(t >= self.lead_in, sine, 0.0)
        speed = np.full(n, self.speed)
        return Commands(COMMAND_PERIOD, np.column_stack([speed, yaw_rate]))


TRAJECTORIES = {
    "traj1": SineScenario(frequency=0.50, amplitude=1.00),
    "traj2": SineScenario(frequency=0.25, amplitude=0.25),
    "traj3": SineScenario(frequency=0.25, amplitude=0.50),
    "traj4": SineScenario(frequency=0.25, amplitude=0.75),
}
"""Tab. 3.6 by name."""
