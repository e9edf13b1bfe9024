"""Robots in motion as a video for slides, drawn by MuJoCo without a window: one robot solid, the others as ghosts."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray
from validation.plants.table import STANDARD
from validation.progress import Progress, Report, silent
from validation.report.stage import Stage
from validation.report.tracks import Track, bright, extent_of
from validation.store import write_atomic
from validation.words import one_line

_ELEVATION, _ASIDE = -30.0, 35.0
"""Direction of the eye: below the horizontal, and beside the direction in which the robots go [degrees]."""
_NEAR = 8.0
"""Distance up to which the eye keeps other robots in view, for robots as large as a Husky [m]."""
_SMOOTH_S = 0.7
"""Time over which the eye follows [s of motion]."""
_TRAIL_POINTS = 120
"""Points of each robot's trail."""
_INK, _PAPER = (20, 20, 24), (255, 255, 255, 200)


class NoGraphicsError(SsmrError):
    """Nothing can be drawn on this machine; the message says what to install."""


class Format(NamedTuple):
    """Size and length of a video."""

    width: int
    height: int
    rate: float
    """Pictures a second [Hz]."""
    longest: float
    """Longest time that it takes [s]; a longer motion is shown faster."""


VIDEO_FORMATS = {".mp4": Format(1280, 720, 25.0, 40.0), ".gif": Format(640, 360, 10.0, 20.0)}
"""What is written, by the ending of the file."""


def check_video(path: Path) -> None:
    """Refuse the path of a video that could not be written.

    Raises:
        ValueError: another ending, or the library that encodes it is missing; the message says what to do.
    """
    if path.suffix.lower() not in VIDEO_FORMATS:
        raise ValueError(f"a video's name ends in {' or '.join(VIDEO_FORMATS)}, unlike {path}")
    if path.suffix.lower() == ".mp4" and find_spec("imageio_ffmpeg") is None:
        how = "pip install 'ssmr-testbed[video]' (in a source tree: '.[video]')"
        raise ValueError(f"a video .mp4 needs imageio-ffmpeg: {how}; .gif needs nothing more")


def write_video(tracks: Sequence[Track], path: Path, title: str, progress: Report = silent) -> None:
    """Write robots in motion as a video, whole or not at all.

    The eye follows the solid robot: MuJoCo's or, without one, the first. A motion that takes longer than a video may is
    shown faster, and the video says so.

    Args:
        tracks: motions over the same time.
        path: .mp4 (1280 x 720, 25 Hz, at most 40 s) or .gif (640 x 360, 10 Hz, at most 20 s).
        title: what stands in its corner.
        progress: told after each picture.

    Raises:
        NoGraphicsError: nothing can be drawn on this machine.
        OSError: the file cannot be written.
        ValueError: as `check_video`.
    """
    check_video(path)
    ending = path.suffix.lower()
    film = _Film(sorted(tracks, key=lambda track: track.name != STANDARD), VIDEO_FORMATS[ending], title)
    write = _write_mp4 if ending == ".mp4" else _write_gif
    with open_renderer(film.stage.model, film.form) as renderer:
        write_atomic(path, lambda temporary: write(film.pictures(renderer, progress), temporary, film.form))


def open_renderer(model: mujoco.MjModel, form: Format) -> mujoco.Renderer:
    """Return MuJoCo's renderer, which draws into memory.

    MuJoCo looks once at the environment variable MUJOCO_GL, when it is imported, and takes GLFW without it, which needs a
    screen. So on Linux EGL and OSMesa are tried where the variable is not set.

    Raises:
        NoGraphicsError: no OpenGL works.
    """
    from mujoco.rendering.classic import gl_context

    failed = []
    kinds = ("egl", "osmesa") if sys.platform.startswith("linux") and not os.environ.get("MUJOCO_GL") else ("",)
    for kind in kinds:
        try:
            if kind:
                gl_context.GLContext = import_module(f"mujoco.{kind}").GLContext
            return mujoco.Renderer(model, form.height, form.width, font_scale=mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # noqa: BLE001 - a library that is missing and a driver that is broken fail in many ways
            failed.append(f"{kind} {one_line(error)[:100]}".strip())
            os.environ.pop("PYOPENGL_PLATFORM", None)  # PyOpenGL chooses its platform when it is imported
            for name in [n for n in sys.modules if n.partition(".")[0] == "OpenGL" or n.startswith("mujoco.egl")]:
                del sys.modules[name]
    how = "install EGL or OSMesa (Debian, Ubuntu: apt install libegl1 libegl-mesa0, or libosmesa6)"
    raise NoGraphicsError(f"no OpenGL works here ({'; '.join(failed)}); {how}")


def _write_mp4(pictures: Iterator[Any], path: Path, form: Format) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(str(path), (form.width, form.height), fps=form.rate, codec="libx264", quality=7)
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(picture.tobytes())
    finally:
        writer.close()


def _write_gif(pictures: Iterator[Any], path: Path, form: Format) -> None:
    few = (picture.quantize(128) for picture in pictures)
    with path.open("wb") as file:  # which pillow would leave open after an interrupt
        next(few).save(file, "GIF", save_all=True, append_images=few, duration=1000.0 / form.rate, loop=0)


class _Film:
    """The pictures of a video: where the robots are in each, and from where they are seen."""

    def __init__(self, tracks: Sequence[Track], form: Format, title: str) -> None:
        self._tracks, self.form, self._title = tracks, form, title
        pieces = max(tracks, key=lambda track: track.t[-1] - track.t[0]).pieces
        self._speed = max(1, math.ceil(sum(float(piece.t[-1] - piece.t[0]) for piece in pieces) / form.longest))
        self.t = np.concatenate([np.arange(p.t[0], p.t[-1] + 1e-9, self._speed / form.rate) for p in pieces])
        self._poses = [self._at(track, track.body) for track in tracks]
        self._turns = [self._at(track, track.turns) for track in tracks]
        extent = extent_of(tracks)
        self._scale = extent.scale
        self._azimuth = math.degrees(math.atan2(extent.along[1], extent.along[0])) + _ASIDE
        self.stage = Stage(tracks[0].robot, [track.name for track in tracks])
        self._look_at, self._distance = self._eyes()

    def _at(self, track: Track, values: FloatArray) -> FloatArray:
        """Return (F, k) values of a track at the pictures' instants, from (M, k)."""
        return np.column_stack([np.interp(self.t, track.t, column) for column in values.T])

    def _eyes(self) -> tuple[FloatArray, FloatArray]:
        """Return (F, 3) points that the eye looks at [m], and (F,) distances from them [m]: all robots that are near."""
        from scipy.ndimage import gaussian_filter1d

        places = np.stack([pose[:, :2] for pose in self._poses])
        offsets = places - places[0]
        offsets *= np.minimum(1.0, _NEAR * self._scale / np.maximum(np.linalg.norm(offsets, axis=-1, keepdims=True), 1e-9))
        low, high = offsets.min(axis=0), offsets.max(axis=0)
        distance = 3.2 * self._scale + 1.1 * np.linalg.norm(high - low, axis=-1)
        height = np.full((len(self.t), 1), 0.2 * self._scale)
        wanted = np.column_stack([places[0] + 0.5 * (low + high), height, distance])
        smooth = gaussian_filter1d(wanted, _SMOOTH_S * self.form.rate / self._speed, axis=0, mode="nearest")
        return smooth[:, :3], smooth[:, 3]

    def pictures(self, renderer: mujoco.Renderer, progress: Report) -> Iterator[Any]:
        """Yield the pictures."""
        from PIL import Image

        stage, camera = self.stage, mujoco.MjvCamera()
        camera.azimuth, camera.elevation = self._azimuth, _ELEVATION
        for index in range(len(self.t)):
            for rank in range(len(self._tracks)):
                stage.place(rank, self._poses[rank][index], self._turns[rank][index])
            stage.settle()
            camera.lookat[:], camera.distance = self._look_at[index], self._distance[index]
            renderer.update_scene(stage.data, camera)
            kept = np.unique(np.r_[0 : index : max(1, len(self.t) // _TRAIL_POINTS), index])
            for rank, track in enumerate(self._tracks):
                height = np.full(len(kept), (0.018 - 0.003 * rank) * self._scale)  # the first one's on top
                points = np.column_stack([self._poses[rank][kept, :2], height])
                _draw_trail(renderer.scene, points, track.name, 0.02 * self._scale)
            yield self._captioned(Image.fromarray(renderer.render()), index)
            progress(Progress(index + 1, len(self.t), "pictures drawn"))

    def _captioned(self, picture: Any, index: int) -> Any:
        """Return a picture with title, time, and a legend that says how far each robot is from the solid one."""
        from matplotlib import get_data_path
        from PIL import ImageDraw, ImageFont

        size = self.form.height // 30
        draw, line, pad = ImageDraw.Draw(picture, "RGBA"), int(1.5 * size), size // 2
        font = ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
        here = self._poses[0][index, :2]
        apart = [f"  {math.dist(here, pose[index, :2]):.2f} m" * (rank > 0) for rank, pose in enumerate(self._poses)]
        names = [f"{track.name}{words}" for track, words in zip(self._tracks, apart, strict=True)]
        lines = [self._title, f"{self.t[index]:.1f} s" + (f"   × {self._speed}" if self._speed > 1 else ""), *names]
        width = max(draw.textlength(text, font) for text in lines) + line
        draw.rectangle((pad, pad, 3 * pad + width, 2 * pad + len(lines) * line), _PAPER)
        for k, text in enumerate(lines):
            top, left = 1.5 * pad + k * line, 2 * pad
            if k >= 2:
                draw.rectangle((left, top + 0.1 * size, left + size, top + 1.1 * size), bright(self._tracks[k - 2].name))
                left += line
            draw.text((left, top), text, _INK, font)
        return picture


def _draw_trail(scene: mujoco.MjvScene, points: FloatArray, name: str, width: float) -> None:
    """Add a flat strip through (K, 3) points [m] to a scene, in the colour of a plant, as far as there is room.

    It is made of boxes: a capsule has a hundred times their triangles, and a machine without a graphics card draws slowly.
    """
    rgba = np.array([*bright(name), 255], dtype=np.float32) / 255.0
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    for start, step, length in zip(points[:-1], steps, lengths, strict=True):
        if length > 0.0 and scene.ngeom < scene.maxgeom:
            (c, s), size = step[:2] / length, np.array([0.5 * length + 0.3 * width, 0.5 * width, 0.05 * width])
            turned = np.array([c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0])
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, start + 0.5 * step, turned, rgba)
            scene.ngeom += 1
