"""Health of a run: wheel loads, inertia and torque say whether a MuJoCo robot can be believed."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ssmr.types import FloatArray, Trajectory
from validation.output import Document
from validation.simulator.description import GRAVITY

LIFT_SHARE = 0.02
"""A wheel whose load falls below this share of its mean has left the ground."""
DEVIATION_LIMIT = 0.10
"""Greatest standard deviation of a wheel's load on flat ground, as a share of its mean."""
_TREMBLE_SHARE = 0.01
"""Deviation of the loads' sum over the weight from which on the loads tremble.

On level ground the sum is the weight and the force that lifts the body, and a robot that drives on
level ground has no cause to rise or fall fast.
"""
START_TIME = 2.5
"""Time at the start of a run in which the loads' sum is not judged [s].

The robot sets off and its body comes to rest. Of a run shorter than twice that, the second half is
judged.
"""
_PUSH_SHARE = 0.028
"""Thrust for measuring the apparent mass, over the weight [1].

It is far below the thrust at which a tyre slides.
"""
_SETTLE_TIME = 1.0
"""Time in which the robot comes to rest [s]."""
_PUSH_TIME = 2.0
"""Time for which the robot is pushed [s]; the second half gives the acceleration."""


Health = Document
"""Verdict on a run's physics, as JSON files have it.

- `lowest_load_share`: least load of any wheel over that wheel's mean [1]; 0 where a wheel lifted.
- `load_deviation`: greatest standard deviation of a wheel's load over its mean [1].
- `apparent_mass_kg`: constant thrust over acceleration, which is the mass, and the inertia of
  wheels and rotors over the radius squared.
- `peak_torque_N_m`: greatest torque of a side; not where wheel rates are given.
- `load_sum_rms_N`: root mean square of the loads' sum less the weight, after `START_TIME`.
- `weight_N`: weight.
- `at_limit`: sentence on motors that stayed at their limit, where they did.
- `ok`: no wheel lifted, and the loads were smooth.
- `advice`: text that says what is wrong and what to change; empty if all is well.

What the loads alone do not give is not in it where only they are judged.
"""


def loads_tremble(health: Health) -> bool:
    """Return whether the loads' sum deviates from the weight by more than a share of it."""
    limit = _TREMBLE_SHARE * health.get("weight_N", 0.0)
    return bool(health.get("load_sum_rms_N", 0.0) > limit)


def health_verdict(health: Health) -> str:
    """Return a run's state in a few words."""
    if not health["ok"]:
        return "unhealthy"
    return "loads tremble" if loads_tremble(health) else "healthy"


def _with_advice(health: Health) -> Health:
    """Return a verdict with `ok` and `advice`."""
    least = health["lowest_load_share"]
    deviation = health["load_deviation"]
    ok = least >= LIFT_SHARE and deviation <= DEVIATION_LIMIT
    sentences = []
    if not ok:
        if least < LIFT_SHARE:
            cause = f"a wheel left the ground (least load {100 * least:.1f} % of its mean)"
        else:
            cause = (
                f"wheel loads are not smooth (deviation {100 * deviation:.1f} % of "
                f"the mean, at most {100 * DEVIATION_LIMIT:.0f} %)"
            )
        sentences.append(
            f"{cause}: keep the soft contact that follows from the size of the wheels, an "
            "elliptic cone and a time step of at most 5 ms; if they are as shipped, lower the "
            "gain, raise the armature or limit the acceleration"
        )
    if loads_tremble(health):
        remedy = (
            "let the driver go over from each command to the next (command_ramp), let its "
            "reference lag, lower the gain, or raise the armature, which makes the robot "
            "heavier to push"
        )
        # without torques the wheel rates were given, and no motor is there to be changed
        if "peak_torque_N_m" not in health:
            remedy = "smooth the given wheel rates"
        sentences.append(
            "wheel loads tremble (their sum deviates from the weight by "
            f"{health['load_sum_rms_N']:.1f} N rms, at most "
            f"{_TREMBLE_SHARE * health['weight_N']:.1f} N): {remedy}"
        )
    if "at_limit" in health:
        sentences.append(health["at_limit"])
    return {**health, "ok": ok, "advice": "; ".join(sentences)}


def check_health(wheel_loads: FloatArray) -> Health:
    """Judge (M, 4) wheel loads [N] of a run."""
    mean = np.maximum(wheel_loads.mean(axis=0), 1e-9)
    least = wheel_loads.min(axis=0) / mean
    deviation = wheel_loads.std(axis=0) / mean
    loads = {"lowest_load_share": float(least.min()), "load_deviation": float(deviation.max())}
    return _with_advice(loads)


def apparent_mass(model: mujoco.MjModel) -> float:
    """Thrust over acceleration [kg] of a resting, undriven robot that is pushed ahead.

    Args:
        model: the robot, on level ground; it is left as it is.
    """
    model = mujoco.MjModel.__copy__(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    for loss in (model.tendon_frictionloss, model.dof_frictionloss, model.dof_damping):
        loss[:] = 0.0
    data = mujoco.MjData(model)
    base = model.body("base").id
    mujoco.mj_step(model, data, nstep=round(_SETTLE_TIME / model.opt.timestep))
    thrust = _PUSH_SHARE * model.body_subtreemass[base] * GRAVITY
    data.xfrc_applied[base, 0] = thrust
    half = round(0.5 * _PUSH_TIME / model.opt.timestep)
    mujoco.mj_step(model, data, nstep=half)
    before = float(data.qvel[0])
    mujoco.mj_step(model, data, nstep=half)
    return thrust * half * model.opt.timestep / (float(data.qvel[0]) - before)


def run_health(
    model: mujoco.MjModel,
    motions: Sequence[Trajectory],
    *,
    given_rates: bool = False,
    at_limit: str | None = None,
) -> Health:
    """Judge a run on level ground: the worst over all its pieces.

    Args:
        model: the robot.
        motions: motions of its body, with the channels `wheel_load_N` and, where no wheel rates
            were given, `torque_N_m`.
        given_rates: the wheels turned at given rates, whatever torque that took.
        at_limit: sentence on motors that stayed at their limit, if they did.
    """
    verdicts = [check_health(m.channels["wheel_load_N"]) for m in motions]
    weight = model.body_subtreemass[model.body("base").id] * GRAVITY
    sums = []
    for m in motions:
        t = m.t - m.t[0]
        late = t >= min(START_TIME, 0.5 * t[-1])
        sums.append(m.channels["wheel_load_N"].sum(axis=1)[late])
    excess = np.concatenate(sums) - weight
    health = {
        "lowest_load_share": min(v["lowest_load_share"] for v in verdicts),
        "load_deviation": max(v["load_deviation"] for v in verdicts),
        "apparent_mass_kg": apparent_mass(model),
    }
    if not given_rates:
        peaks = [np.abs(m.channels["torque_N_m"]).max() for m in motions]
        health["peak_torque_N_m"] = float(max(peaks))
    health |= {"load_sum_rms_N": float(np.sqrt(np.mean(excess**2))), "weight_N": weight}
    if at_limit is not None:
        health["at_limit"] = at_limit
    return _with_advice(health)
