"""Fit the kinematic model to the first 50 s of a log and judge it on the rest.

`sample` is the log that travels with the package; put the path of your own in its place.
"""

from validation.compare import compare
from validation.fit import fit

LOG = "sample"
SEEN = 50.0

fitted = fit("kinematic", to=LOG, input="wheels", until=SEEN, seed=1)
print(fitted.table())
fitted.profile.save("runs/examples/fit_a_log.toml")
fitted.figure().savefig("runs/examples/fit_a_log.png")

for name, profile in (("husky-tile", "husky-tile"), ("fitted", fitted.profile)):
    judged = compare(
        LOG, profile, plants=("kinematic",), input="wheels", since=SEEN, horizons=(6.0,)
    )
    errors = judged.as_dict()["plants"]["kinematic"]["horizons"]["6"]["overlapping"]
    print(
        f"{name}: {1e3 * errors['position_median_m']:.0f} mm after 6 s, "
        f"median of {errors['n']} windows"
    )
