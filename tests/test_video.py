"""Videos: robots stand where the motion says, pictures show them, and a file is there whole or not at all."""

from __future__ import annotations

import gc
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from ssmr.types import Commands, State
from validation.bench.sources import Piece, Source
from validation.compare import compare
from validation.plants.profile import Profile
from validation.progress import Progress
from validation.report import video
from validation.report.motions import Comparison
from validation.report.stage import Stage
from validation.report.tracks import bright
from validation.simulator.description import load_robot

pytest.importorskip("PIL.Image")
from PIL import Image, ImageChops

pipes_left_open = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
"""imageio-ffmpeg leaves a pipe to ffmpeg open when ffmpeg has ended first; the test collects it before it ends."""
SMALL = {".mp4": video.Format(320, 192, 25.0, 0.2), ".gif": video.Format(320, 192, 10.0, 0.5)}


@pytest.fixture(scope="module")
def comparison(lab: Profile) -> Comparison:
    commands = Commands(0.1, np.tile([0.8, 0.6], (20, 1)))
    source = Source("a curve", (Piece(commands, State(), None, None),), "mujoco", 0.02)
    return compare(source, lab, ("mujoco", "kinematic"))


@pytest.fixture
def graphics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "VIDEO_FORMATS", SMALL)
    try:
        video.open_renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), SMALL[".gif"]).close()
    except video.NoGraphicsError as error:
        pytest.skip(str(error))


def test_robots_stand_where_they_are_put() -> None:
    stage = Stage(load_robot(), ("mujoco", "improved"))
    stage.place(1, np.array([2.0, -1.0, 0.5 * math.pi]), np.array([0.3, -0.2]))
    stage.settle()
    reference = stage.data.body("1").xpos
    assert reference == pytest.approx([2.0, -1.0, 0.0])
    ahead = stage.data.body("1_front_left").xpos - stage.data.body("1_rear_left").xpos
    assert ahead[:2] == pytest.approx([0.0, load_robot().geometry.wheelbase])
    assert [float(stage.data.joint(f"1_{wheel}").qpos[0]) for wheel in ("front_left", "rear_right")] == [0.3, -0.2]
    assert stage.data.body("0").xpos == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.usefixtures("graphics")
def test_a_gif_shows_the_robots_and_the_legend(comparison: Comparison, tmp_path: Path) -> None:
    path, told = tmp_path / "a.gif", list[Progress]()
    comparison.write_video(path, told.append)
    with Image.open(path) as film:
        assert (film.size, film.n_frames) == ((320, 192), 6)  # type: ignore[attr-defined]
        first = film.convert("RGB")
        film.seek(5)
        last = film.convert("RGB")
    assert [p.done for p in told] == [1, 2, 3, 4, 5, 6]
    assert ImageChops.difference(first, last).getbbox() is not None
    red, green, blue = (np.asarray(last, dtype=float)[..., k] for k in range(3))
    for name in ("mujoco", "kinematic"):
        r, g, b = bright(name)
        assert np.sum((abs(red - r) < 12) & (abs(green - g) < 12) & (abs(blue - b) < 12)) > 20, name
    solid = (red > 150) & (green > 110) & (blue < 80)  # the yellow hull
    assert solid[64:].sum() > 30


@pipes_left_open
@pytest.mark.usefixtures("graphics")
def test_a_video_can_be_read_back(comparison: Comparison, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "a.mp4"
    comparison.write_video(path)
    frames = ffmpeg.read_frames(str(path))
    about = next(frames)
    assert (about["size"], about["fps"]) == ((320, 192), 25.0)
    assert len(list(frames)) == 6
    frames.close()
    gc.collect()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


@pipes_left_open
@pytest.mark.usefixtures("graphics")
def test_an_interrupt_leaves_what_was_there(comparison: Comparison, tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    path.write_text("before")

    def interrupt(now: Progress) -> None:
        if now.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        comparison.write_video(path, interrupt)
    gc.collect()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [(path.name, "before")]
