"""Drive MuJoCo and the thesis' models with the same commands.

Print how far they part, keep picture and recording.
"""

from validation import load_profile
from validation.compare import compare

lab = load_profile("thesis-lab")
comparison = compare("traj4", lab, plants=("mujoco", "improved", "coulomb", "linear"))
print(comparison.table())
for path in comparison.save("runs/examples/compare_plants"):
    print(path)
