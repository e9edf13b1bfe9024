"""Drive the MuJoCo robot with more and less friction beside the improved model."""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

from validation import load_profile, sweep
from validation.compare import compare

lab = load_profile("thesis-lab")
section = lab.plants["mujoco"]


def errors(friction):
    """Return the columns of one row."""
    slippery = replace(section, parameters=replace(section.parameters, friction=friction))
    profile = replace(lab, plants={**lab.plants, "mujoco": slippery})
    comparison = compare("traj4", profile, plants=("mujoco",), reference="improved")
    return {"friction": friction, "sync_rms_m": comparison.scores["mujoco"].metrics["sync_rms_m"]}


rows = sweep({f"{mu:g}": mu for mu in (0.3, 0.4, 0.5, 0.6)}, {"traj4": errors}).rows
for row in rows:
    print(
        f"friction {row['friction']:.1f}: {1e3 * row['sync_rms_m']:.0f} mm from the improved "
        "model at equal times"
    )

figure, ax = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
ax.plot([row["friction"] for row in rows], [1e3 * row["sync_rms_m"] for row in rows], "o-")
ax.set(xlabel="friction", ylabel="distance at equal times, rms [mm]", ylim=(0.0, None))
picture = Path("runs/examples/sweep.png")
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture)
