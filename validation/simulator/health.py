"""Whether a run of a MuJoCo robot can be believed: wheel loads, inertia, torque and slip speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from ssmr.types import FloatArray, Trajectory
from validation.simulator.calibration import Calibration
from validation.simulator.contact_law import ContactLaw, contact_law
from validation.simulator.description import SIDES, WHEELS
from validation.simulator.model import GRAVITY, wheel_geoms

LIFT_SHARE = 0.02
"""A wheel whose load falls below this share of its mean has left the ground."""
DEVIATION_LIMIT = 0.10
"""Greatest standard deviation of a wheel's load, as a share of its mean, that a run on flat ground may have."""
TREMBLE_SHARE = 0.01
"""Deviation of the loads' sum over the weight from which on the loads tremble. On level ground the sum is the weight and
what lifts the body, and a robot that drives on level ground has no cause to rise or fall fast."""
START_TIME = 2.5
"""Time at the start of a run in which the loads' sum is not judged [s]: the robot sets off and its body comes to rest. Of a
run shorter than twice that, the second half is judged."""
PUSH_SHARE = 0.028
"""Thrust for measuring the apparent mass, over the weight [1]: far below what makes a tyre slide."""
SETTLE_TIME, PUSH_TIME = 1.0, 2.0
"""Time in which the robot comes to rest, and time for which it is pushed [s]; the second half gives the acceleration."""


@dataclass(frozen=True)
class Health:
    """Verdict on a run's physics. What is None is not known: a run's loads alone do not tell it."""

    lowest_load_share: float
    """Least load of any wheel over that wheel's mean [1]; 0 where a wheel lifted."""
    load_deviation: float
    """Greatest standard deviation of a wheel's load over its mean [1]."""
    apparent_mass_kg: float | None = None
    """Constant thrust over acceleration [kg]: the mass, and the inertia of wheels and rotors over the radius squared."""
    peak_torque_N_m: float | None = None
    """Greatest torque of a side over the run [N m]; unknown where wheel rates are given, whatever torque they take."""
    load_sum_rms_N: float | None = None
    """Root mean square of the loads' sum less the weight, after the start (`START_TIME`) [N]."""
    weight_N: float | None = None
    """Weight [N]."""
    slip_speed_m_s: float | None = None
    """Greatest slip speed of a tyre over the run [m/s] (`Examined.slip_speeds`)."""
    slip_limit_m_s: float | None = None
    """Slip speed at which the soft contact lifts a tyre off the ground [m/s] (`contact_law`)."""
    ride_rise_m: float | None = None
    """How much higher the body rides at the greatest slip speed than where its wheels roll [m], by the contact's law."""

    @property
    def ok(self) -> bool:
        """No wheel lifted, and the loads were smooth."""
        return self.lowest_load_share >= LIFT_SHARE and self.load_deviation <= DEVIATION_LIMIT

    @property
    def trembles(self) -> bool:
        """Whether the loads' sum deviates from the weight by more than `TREMBLE_SHARE` of it."""
        if self.load_sum_rms_N is None or self.weight_N is None:
            return False
        return self.load_sum_rms_N > TREMBLE_SHARE * self.weight_N

    @property
    def slips_too_fast(self) -> bool:
        """Whether a tyre slipped faster than the soft contact can hold it on the ground."""
        return self.slip_speed_m_s is not None and self.slip_speed_m_s > (self.slip_limit_m_s or math.inf)

    @property
    def verdict(self) -> str:
        """Return in a few words how the run is."""
        if not self.ok:
            return "unhealthy"
        found = ("loads tremble",) * self.trembles + ("slips too fast",) * self.slips_too_fast
        return ", ".join(found) or "healthy"

    @property
    def advice(self) -> str:
        """Text that says what is wrong and what to change; empty if all is well."""
        return "; ".join(filter(None, (self._of_loads(), self._of_trembling(), self._of_slip())))

    def _of_loads(self) -> str:
        if self.ok:
            return ""
        what = (
            f"a wheel left the ground (least load {100 * self.lowest_load_share:.1f} % of its mean)"
            if self.lowest_load_share < LIFT_SHARE
            else f"wheel loads are not smooth (deviation {100 * self.load_deviation:.1f} % of the mean, "
            f"at most {100 * DEVIATION_LIMIT:.0f} %)"
        )
        return (
            f"{what}: keep the soft contact that follows from the size of the wheels, an elliptic cone and a time step "
            "of at most 5 ms; if they are as shipped, lower the gain, raise the armature or limit the acceleration"
        )

    def _of_trembling(self) -> str:
        if not self.trembles or self.load_sum_rms_N is None or self.weight_N is None:
            return ""
        what = (
            f"wheel loads tremble (their sum deviates from the weight by {self.load_sum_rms_N:.1f} N rms, "
            f"at most {TREMBLE_SHARE * self.weight_N:.1f} N)"
        )
        if self.peak_torque_N_m is None:
            return f"{what}: smooth the given wheel rates"
        return (
            f"{what}: let the driver go over from each command to the next (command_ramp), let its reference lag, "
            "lower the gain, or raise the armature, which makes the robot heavier to push"
        )

    def _of_slip(self) -> str:
        if not self.slips_too_fast:
            return ""
        return (
            f"a tyre slips at {self.slip_speed_m_s:.2f} m/s, but the soft contact lifts it off the ground beyond "
            f"{self.slip_limit_m_s:.2f} m/s: drive more gently, or lower the friction"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return all that is known, with the verdict and the advice, as JSON files have it."""
        known = {name: value for name, value in asdict(self).items() if value is not None}
        return {**known, "ok": self.ok, "advice": self.advice}


def check_health(wheel_loads: FloatArray) -> Health:
    """Judge (M, 4) wheel loads [N] of a run."""
    mean = np.maximum(wheel_loads.mean(axis=0), 1e-9)
    return Health(float((wheel_loads.min(axis=0) / mean).min()), float((wheel_loads.std(axis=0) / mean).max()))


@dataclass(frozen=True, eq=False)
class Examined:
    """What a robot's model says about itself, at rest and when it is pushed."""

    apparent_mass: float
    """Constant thrust over acceleration [kg]."""
    weight: float
    """Weight [N]."""
    contact: ContactLaw
    """The law of the contact under the tyre that slip lifts first."""
    places: FloatArray
    """(4, 2) places of the wheels in the body [m], ahead and to the left; in the order of `WHEELS`."""
    radii: FloatArray
    """(2,) rolling radii of the left and the right wheels [m]."""
    grip: tuple[float, float]
    """Friction of a tyre along its wheel and across it, over the greater of both [1]."""

    def slip_speeds(self, motion: Trajectory) -> FloatArray:
        """Return (M, 4) slip speeds of the tyres [m/s] in a motion of the body.

        Where friction depends on direction, slip in the direction of less friction counts less: the contact feels the
        product.
        """
        v_x, v_y, rate = motion.twist.T
        rolling = (motion.wheels * self.radii)[:, [SIDES.index(wheel.split("_")[1]) for wheel in WHEELS]]
        along = v_x[:, None] - rate[:, None] * self.places[:, 1] - rolling
        across = v_y[:, None] + rate[:, None] * self.places[:, 0]
        return np.hypot(self.grip[0] * along, self.grip[1] * across)


def examine(model: mujoco.MjModel, calibration: Calibration) -> Examined:
    """Return what a calibrated model says about itself on level ground.

    Args:
        model: the robot on level ground; it is left as it is.
        calibration: the robot's numbers.

    Raises:
        ValueError: no tyre touches the ground, or the friction cone is not elliptic.
    """
    model = mujoco.MjModel.__copy__(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    for loss in (model.tendon_frictionloss, model.dof_frictionloss, model.dof_damping):
        loss[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(SETTLE_TIME / model.opt.timestep))
    contact = contact_law(model, data, wheel_geoms(model))
    base = model.body("base").id
    half, ratio = 0.5 * calibration.radius_difference, calibration.friction_ratio
    return Examined(
        _pushed(model, data, base), float(model.body_subtreemass[base]) * GRAVITY, contact,
        np.array([model.body(wheel).pos[:2] for wheel in WHEELS]),
        np.array([calibration.wheel_radius + half, calibration.wheel_radius - half]),
        (1.0 / max(ratio, 1.0), ratio / max(ratio, 1.0)),
    )  # fmt: skip


def _pushed(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> float:
    """Push the base of a resting, undriven robot ahead, and return thrust over acceleration [kg]."""
    thrust = PUSH_SHARE * float(model.body_subtreemass[base]) * GRAVITY
    data.xfrc_applied[base, 0] = thrust
    half = round(0.5 * PUSH_TIME / model.opt.timestep)
    mujoco.mj_step(model, data, nstep=half)
    before = float(data.qvel[0])
    mujoco.mj_step(model, data, nstep=half)
    return thrust * half * model.opt.timestep / (float(data.qvel[0]) - before)


def run_health(examined: Examined, motions: Sequence[Trajectory], *, given_rates: bool = False) -> Health:
    """Judge a run on level ground: the worst over all its pieces.

    Args:
        examined: the robot.
        motions: motions of its body, with the channels `wheel_load_N` and `torque_N_m`.
        given_rates: the wheels turned at given rates, whatever torque that took.
    """
    verdicts = [check_health(m.channels["wheel_load_N"]) for m in motions]
    slip = max(float(examined.slip_speeds(m).max()) for m in motions)
    excess = np.concatenate([_after_start(m) for m in motions]) - examined.weight
    rms = float(np.sqrt(np.mean(excess**2)))
    peak = max(float(np.abs(m.channels["torque_N_m"]).max()) for m in motions)
    contact = examined.contact
    return Health(
        min(v.lowest_load_share for v in verdicts), max(v.load_deviation for v in verdicts), examined.apparent_mass,
        None if given_rates else peak, rms, examined.weight, slip, contact.slip_limit, contact.rise(slip),
    )  # fmt: skip


def _after_start(motion: Trajectory) -> FloatArray:
    """Return the loads' sum [N] after the start of a run."""
    since = motion.t - motion.t[0]
    total: FloatArray = motion.channels["wheel_load_N"].sum(axis=1)
    return total[since >= min(START_TIME, 0.5 * since[-1])]
