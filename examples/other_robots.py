"""Every shipped robot gets the same commands.

This prints how far the improved model and MuJoCo move apart.
"""

from validation.compare import compare

for robot in ("husky", "jackal", "pioneer3at", "warthog"):
    result = compare("traj4", plants=("mujoco", "improved"), robot=robot)
    apart = result.as_dict()["plants"]["improved"]
    print(
        f"{robot:10s} {1e3 * apart['sync_rms_m']:4.0f} mm apart (rms), "
        f"length of the path {apart['d_ratio']:.3f} of MuJoCo's"
    )
