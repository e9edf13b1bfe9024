"""Robots in motion as a video for slides, drawn by MuJoCo without a window: one robot solid, the others as ghosts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.plants.table import STANDARD
from validation.progress import Progress, Report, silent
from validation.report.graphics import open_graphics
from validation.report.stage import Stage, draw_trail, ink, new_scene
from validation.report.tracks import Extent, Track
from validation.store import write_atomic

ENDINGS = (".mp4", ".gif")
"""Endings of the files that can be written."""
_NEAR = 8.0
"""Distance up to which the eye keeps other robots in view, for robots as large as a Husky [m]."""
_ELEVATION, _ASIDE = -30.0, 35.0
"""Direction of the eye: below the horizontal, and beside the direction in which the robots go [degrees]."""
_SMOOTH_S = 0.7
"""Time over which the eye follows [s of motion]: over a time of video it would lose robots that are shown fast."""
_TRAIL_POINTS = 120
"""Points of each robot's trail."""
_INK, _PAPER = (20, 20, 24), (255, 255, 255, 200)


@dataclass(frozen=True)
class _Format:
    """Size and length of a video."""

    width: int
    height: int
    rate: float
    """Pictures a second [Hz]."""
    longest: float
    """Longest time that it takes [s]; a longer motion is shown faster."""


_FORMATS = {".mp4": _Format(1280, 720, 25.0, 40.0), ".gif": _Format(640, 360, 10.0, 20.0)}


def check_video(path: Path) -> None:
    """Refuse the path of a video that could not be written.

    Raises:
        ValueError: another ending, or the library that encodes it is missing; the message says what to do.
    """
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"a video's name ends in {' or '.join(ENDINGS)}, unlike {path}")
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
    form = _FORMATS[path.suffix.lower()]
    ordered = sorted(tracks, key=lambda track: track.name != STANDARD)
    film = _Film(ordered, form, title)
    write = _write_mp4 if path.suffix.lower() == ".mp4" else _write_gif
    context = open_graphics(form.width, form.height)
    try:
        write_atomic(path, lambda temporary: write(film.pictures(progress), temporary, form))
    finally:
        context.free()


def _write_mp4(pictures: Iterator[Any], path: Path, form: _Format) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(str(path), (form.width, form.height), fps=form.rate, codec="libx264", quality=7)
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(picture.tobytes())
    finally:
        writer.close()


def _write_gif(pictures: Iterator[Any], path: Path, form: _Format) -> None:
    few = (picture.quantize(128) for picture in pictures)
    with path.open("wb") as file:  # which pillow would leave open after an interrupt
        next(few).save(file, "GIF", save_all=True, append_images=few, duration=1000.0 / form.rate, loop=0)


class _Film:
    """The pictures of a video: where the robots are in each, and from where they are seen."""

    def __init__(self, tracks: Sequence[Track], form: _Format, title: str) -> None:
        self._tracks, self._form, self._title = tracks, form, title
        pieces = max(tracks, key=lambda track: track.t[-1] - track.t[0]).pieces
        seconds = sum(float(piece.t[-1] - piece.t[0]) for piece in pieces)
        self._speed = max(1, math.ceil(seconds / form.longest))
        step = self._speed / form.rate
        self.t = np.concatenate([np.arange(p.t[0], p.t[-1] + 1e-9, step) for p in pieces])
        self._poses = [self._at(track, track.body) for track in tracks]
        self._turns = [self._at(track, track.turns) for track in tracks]
        self._raised = [self._at(track, track.raised) for track in tracks]
        extent = Extent(tracks)
        self._scale, self._along = extent.scale, extent.along
        reach = 0.5 * extent.reach + 10.0 * extent.scale
        corners = extent.middle + np.array([[-reach], [reach]])
        self._stage = Stage(tracks[0].robot, [track.name for track in tracks], tracks[0].terrain, corners)
        self._look_at, self._distance = self._eyes()

    def _at(self, track: Track, values: FloatArray) -> FloatArray:
        """Return (F, k) values of a track at the pictures' instants, from (M, k)."""
        return np.column_stack([np.interp(self.t, track.t, column) for column in values.T])

    def _eyes(self) -> tuple[FloatArray, FloatArray]:
        """Return (F, 3) points that the eye looks at [m], and (F,) distances from them [m]: all robots that are near."""
        from scipy.ndimage import gaussian_filter1d

        places = np.stack([pose[:, :2] for pose in self._poses])
        offsets = places - places[0]
        apart = np.linalg.norm(offsets, axis=-1, keepdims=True)
        offsets *= np.minimum(1.0, _NEAR * self._scale / np.maximum(apart, 1e-9))
        low, high = offsets.min(axis=0), offsets.max(axis=0)
        middle = places[0] + 0.5 * (low + high)
        distance = 3.2 * self._scale + 1.1 * np.linalg.norm(high - low, axis=-1)
        height = self._raised[0][:, :1] + 0.2 * self._scale
        wanted = np.column_stack([middle, height, distance])
        smooth = gaussian_filter1d(wanted, _SMOOTH_S * self._form.rate / self._speed, axis=0, mode="nearest")
        return smooth[:, :3], smooth[:, 3]

    def pictures(self, progress: Report) -> Iterator[Any]:
        """Yield the pictures, drawn in the OpenGL context that is current."""
        from PIL import Image

        form, model = self._form, self._stage.model
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        try:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
            scene, camera, option = new_scene(model), mujoco.MjvCamera(), mujoco.MjvOption()
            camera.azimuth = math.degrees(math.atan2(self._along[1], self._along[0])) + _ASIDE
            camera.elevation = _ELEVATION
            area, pixels = mujoco.MjrRect(0, 0, form.width, form.height), np.empty((form.height, form.width, 3), np.uint8)
            for index in range(len(self.t)):
                self._set_scene(index, scene, camera, option)
                mujoco.mjr_render(area, scene, context)
                mujoco.mjr_readPixels(pixels, None, area, context)
                yield self._captioned(Image.fromarray(pixels[::-1]), index)
                progress(Progress(index + 1, len(self.t), "pictures drawn"))
        finally:
            context.free()

    def _set_scene(self, index: int, scene: Any, camera: Any, option: Any) -> None:
        stage = self._stage
        for rank in range(len(self._tracks)):
            stage.place(rank, self._poses[rank][index], self._turns[rank][index], tuple(self._raised[rank][index]))
        stage.settle()
        camera.lookat[:], camera.distance = self._look_at[index], self._distance[index]
        mujoco.mjv_updateScene(stage.model, stage.data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene)
        kept = np.unique(np.r_[0 : index : max(1, len(self.t) // _TRAIL_POINTS), index])
        for rank, track in enumerate(self._tracks):
            height = self._raised[rank][kept, 0] + (0.018 - 0.003 * rank) * self._scale  # the first one's on top
            draw_trail(scene, np.column_stack([self._poses[rank][kept, :2], height]), track.name, 0.02 * self._scale)

    def _captioned(self, picture: Any, index: int) -> Any:
        """Return a picture with title, time, and a legend that says how far each robot is from the solid one."""
        from PIL import ImageDraw

        size = self._form.height // 30
        draw, line, pad = ImageDraw.Draw(picture, "RGBA"), int(1.5 * size), size // 2
        rows = [(track.name, ink(track.name)) for track in self._tracks]
        here = self._poses[0][index, :2]
        gaps = [f"{math.dist(here, pose[index, :2]):.2f} m" for pose in self._poses[1:]]
        told = [rows[0][0], *(f"{name}  {gap}" for (name, _), gap in zip(rows[1:], gaps, strict=True))]
        font, clock = _font(size), f"{self.t[index]:.1f} s" + (f"   × {self._speed}" if self._speed > 1 else "")
        width = max(draw.textlength(text, font) for text in (self._title, clock, *told)) + line
        draw.rectangle((pad, pad, 3 * pad + width, 2 * pad + (len(told) + 2) * line), _PAPER)
        for k, text in enumerate((self._title, clock)):
            draw.text((2 * pad, 1.5 * pad + k * line), text, _INK, font)
        for k, (text, (_, rgb)) in enumerate(zip(told, rows, strict=True), start=2):
            top = 1.5 * pad + k * line
            draw.rectangle((2 * pad, top + 0.1 * size, 2 * pad + size, top + 1.1 * size), rgb)
            draw.text((2 * pad + line, top), text, _INK, font)
        return picture


@cache
def _font(size: int) -> Any:
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
