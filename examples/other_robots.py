"""Every shipped robot gets the same commands.

This prints how far the improved model and MuJoCo move apart, and draws MuJoCo's paths.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from validation.compare import compare

figure, ax = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
for robot in ("husky", "jackal", "pioneer3at", "warthog"):
    result = compare("traj4", plants=("mujoco", "improved"), robot=robot)
    apart = result.as_dict()["plants"]["improved"]
    print(
        f"{robot:10s} {1e3 * apart['sync_rms_m']:4.0f} mm apart (rms), "
        f"length of the path {apart['d_ratio']:.3f} of MuJoCo's"
    )
    ax.plot(*result.motion("mujoco").xy.T, label=result.profile.robot.title)
ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
ax.legend()
picture = Path("runs/examples/other_robots.png")
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture)
