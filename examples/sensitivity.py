"""Change one number of a robot at a time, by a tenth up and down.

How far does trajectory 4 move, and which measure sees it? Each number of the table is the greater
of the two differences from the robot as it is.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

from ssmr.metrics.declared import compare_paths, compare_signals
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import State
from validation import load_profile
from validation.output import ignore_progress
from validation.plants.profile import make_plant
from validation.report.table import Table, text_tables
from validation.sweep import sweep

LAB = load_profile("thesis-lab")
TENTH = ((0.9, 0.0), (1.1, 0.0))
SHARED = ("wheel_radius", "gain", "delay_v delay_w", "command_half_track", "acceleration_v")
VARIED = {
    "mujoco": (
        "mass",
        "friction",
        "rolling_resistance",
        "armature",
        "half_track",
        "integral_gain",
        "dc_stiffness",
        *SHARED,
    ),
    "improved": ("mass", "yaw_inertia", "u_x", "mu_d", "mu_s", "effective_half_track", *SHARED[:4]),
}
"""Numbers of each plant; those in one text are changed together."""
VARIANTS: dict[str, tuple[str, str, tuple[tuple[float, float], ...]]] = {
    f"{plant}: {names}": (plant, names, TENTH) for plant in VARIED for names in VARIED[plant]
}
VARIANTS |= {
    # no rigid body has a tenth more
    "mujoco: yaw_inertia": ("mujoco", "yaw_inertia", ((0.9, 0.0), (1.09, 0.0))),
    "mujoco: yaw_inertia -23 %": ("mujoco", "yaw_inertia", ((0.77, 0.0),)),
    "mujoco: armature x5": ("mujoco", "armature", ((5.0, 0.0),)),
    "mujoco: delay +40 ms": ("mujoco", "delay_v delay_w", ((1.0, 0.04),)),
    "mujoco: com_x +10 mm": ("mujoco", "com_x", ((1.0, 0.01),)),
}


def driven(plant, names="", factor=1.0, more=0.0):
    """Return trajectory 4 of a plant whose named numbers are times `factor`, plus `more`."""
    section = LAB.section(plant)
    for name in names.split():
        part = next(
            p for p in ("parameters", "drive", "vehicle") if hasattr(getattr(section, p), name)
        )
        owner = getattr(section, part)
        section = replace(
            section, **{part: replace(owner, **{name: factor * getattr(owner, name) + more})}
        )
    changed = replace(LAB, plants={**LAB.plants, plant: section})
    return make_plant(changed, plant).run(TRAJECTORIES["traj4"].commands(), State(), 0.008)


def differences(variant):
    """Return the greatest of each measure between the robot as it is and the changed ones."""
    plant, names, changes = variant
    as_it_is = driven(plant)
    measured = [driven(plant, names, *change) for change in changes]
    pairs = [
        {**compare_paths(motion, as_it_is), **compare_signals([motion], [as_it_is])}
        for motion in measured
    ]
    columns = (
        "d_rms_m",
        "sync_rms_m",
        "yaw_rms_rad",
        "yaw_rate_rms_rad_s",
        "yaw_acceleration_rms_rad_s2",
        "torque_rms_N_m",
    )
    return {key: max(measures[key] for measures in pairs) for key in columns}


swept = sweep(VARIANTS, {"trajectory 4": differences}, workers=None, progress=ignore_progress)
print(text_tables([Table("A tenth of one number on trajectory 4", swept.rows)], swept.notes))

moved = {row["variant"]: 1e3 * row["sync_rms_m"] for row in swept.rows}
figure, ax = plt.subplots(figsize=(7.0, 6.0), layout="constrained")
names = [name.replace("mujoco", "MuJoCo").replace("_", " ") for name in moved]
ax.barh(names, list(moved.values()))
ax.invert_yaxis()
ax.set(xlabel="distance from the robot as it is at equal times, rms [mm]")
picture = Path("runs/examples/sensitivity.png")
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture)
