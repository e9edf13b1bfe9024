"""Draw docs/img/husky.webp: a real Husky and its simulation along the log `husky`.

Run it as `python docs/make_moving_picture.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from pictures import stamp_of
from PIL import Image

from ssmr.geometry import rotate_body_to_world
from validation.compare import Comparison, compare

OUT = Path(__file__).parent / "img" / "husky.webp"
UNTIL_S = 30.0
FRAMES_S = 10.0
"""Frames a second; the film is twice as fast as the robot."""
REAL = "0.1"
SIMULATED = "#d08c00"


def draw(run: Comparison, k: int, size: tuple[float, float]) -> Image.Image:
    """Return the picture at a sample of the motion."""
    truth = run.truth[0]
    there = run.motion("mujoco")
    band = run.scores["mujoco"].band
    assert band is not None
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    paths, errors = figure.subplots(1, 2, width_ratios=(3, 2))
    for motion, ink, name in ((truth, REAL, "real Husky"), (there, SIMULATED, "MuJoCo")):
        paths.plot(*motion.xy[: k + 1].T, color=ink, linewidth=2.0, label=name)
        paths.plot(*motion.xy[k], "o", color=ink, markersize=7.0)
        ahead = rotate_body_to_world(np.array([0.25, 0.0]), motion.yaw[k])
        paths.plot(*np.transpose([motion.xy[k], motion.xy[k] + ahead]), color=ink, linewidth=3.0)
    (covariance,) = band.covariance(there.pose, np.array([0]), np.array([k]))
    axes = rotate_body_to_world(np.eye(2), there.yaw[0]).T
    values, vectors = np.linalg.eigh(axes @ covariance @ axes.T)
    width, height = 2.0 * band.reach_position * np.sqrt(np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0]))
    where = Ellipse(tuple(there.xy[k]), width, height, angle=angle, color=SIMULATED, alpha=0.2)
    paths.add_patch(where)
    middle = 0.5 * (truth.xy.max(axis=0) + truth.xy.min(axis=0))
    paths.set(xlim=middle[0] + np.array([-1.7, 1.7]), ylim=middle[1] + np.array([-1.5, 1.5]))
    paths.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    paths.set_title("The same wheel rates; shaded: 90 % band", fontsize=10)
    paths.legend(loc="upper left", fontsize=9, frameon=False)
    t = truth.t - truth.t[0]
    apart = 100.0 * np.hypot(*(there.xy - truth.xy).T)
    errors.plot(t[: k + 1], apart[: k + 1], color=SIMULATED, linewidth=2.0)
    errors.set(xlim=(0.0, t[-1]), ylim=(0.0, 1.1 * apart.max()), xlabel="time [s]")
    errors.set_title("How far apart [cm]", fontsize=10)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def main() -> None:
    """Draw every frame and write the film."""
    first = compare("husky", plants=("mujoco",), input="wheels", bands=True)
    begin = float(first.truth[0].t[0])
    run = compare("husky", plants=("mujoco",), input="wheels", bands=True, until=begin + UNTIL_S)
    t = run.truth[0].t
    at = np.searchsorted(t, np.arange(t[0] + 0.5, t[-1], 2.0 / FRAMES_S))
    frames = [draw(run, int(k), (7.2, 3.6)) for k in (*at, len(t) - 1)]
    durations = [int(1000 / FRAMES_S)] * len(at) + [3000]
    frames[0].save(
        OUT,
        save_all=True,
        append_images=frames[1:],
        duration=durations,
        loop=0,
        quality=60,
        exif=stamp_of("make_moving_picture.py"),
    )


if __name__ == "__main__":
    main()
