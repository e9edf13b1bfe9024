"""Drive the MuJoCo robot with more and less friction beside the improved model."""

from dataclasses import replace

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


for row in sweep({f"{mu:g}": mu for mu in (0.3, 0.4, 0.5, 0.6)}, {"traj4": errors}).rows:
    print(
        f"friction {row['friction']:.1f}: {1e3 * row['sync_rms_m']:.0f} mm from the improved "
        "model at equal times"
    )
