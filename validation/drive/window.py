"""MuJoCo's viewer as the window that a driver looks at: robots, their names, keys and a gamepad."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray
from validation.drive.hands import KEYS
from validation.report.stage import Stage, ink
from validation.words import ascii_text, one_line

_HELP = "arrows: faster, slower, left, right\nenter: straight on, space: stop\nclose the window to end"


class NoWindowError(SsmrError, ValueError):
    """No window can be opened here; the message says what to do."""


class DriveWindow:
    """A window that shows a stage from behind its first robot; the mouse moves the eye."""

    def __init__(self, stage: Stage) -> None:
        """Open the window.

        Raises:
            NoWindowError: there is no screen, or no OpenGL for a window.
        """
        instead = "drive without a window by --keys FILE"
        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise NoWindowError(f"there is no screen for MuJoCo's viewer; {instead}")
        import mujoco.viewer

        self._stage, self._pressed, self._pad = stage, deque[int](maxlen=100), True
        try:
            self._viewer: Any = mujoco.viewer.launch_passive(
                stage.model, stage.data, key_callback=self._pressed.append, show_left_ui=False, show_right_ui=False
            )
        except (RuntimeError, mujoco.FatalError) as error:  # on macOS it says that mjpython must run the program
            raise NoWindowError(f"MuJoCo's viewer cannot be opened ({one_line(error)}); {instead}") from error
        scale = float(stage.looks.scale.max())
        with self._viewer.lock():
            camera = self._viewer.cam
            camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, stage.model.body("0").id
            camera.distance, camera.azimuth, camera.elevation = 4.5 * scale, 0.0, -30.0

    @property
    def is_open(self) -> bool:
        """True until the user closes the window."""
        return bool(self._viewer.is_running())

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()

    def keys(self) -> list[str]:
        """Return the keys that were pressed or repeated since the last call."""
        codes = [self._pressed.popleft() for _ in range(len(self._pressed))]
        return [KEYS[code] for code in codes if code in KEYS]

    def sticks(self) -> tuple[float, float] | None:
        """Return the deflections of the first gamepad: the left stick ahead, either stick to the left; None without one."""
        import glfw

        state = glfw.get_gamepad_state(glfw.JOYSTICK_1) if glfw.joystick_is_gamepad(glfw.JOYSTICK_1) else None
        if not state:
            return None
        axes = state.axes
        return -axes[glfw.GAMEPAD_AXIS_LEFT_Y], -max(
            axes[glfw.GAMEPAD_AXIS_LEFT_X], axes[glfw.GAMEPAD_AXIS_RIGHT_X], key=abs
        )

    def show(self, poses: Sequence[FloatArray], turns: FloatArray, status: str) -> None:
        """Show all robots at (3,) poses with (R, 2) turned wheels, ghosts with their names, and a line of status."""
        stage, viewer = self._stage, self._viewer
        with viewer.lock():
            for rank, pose in enumerate(poses):
                stage.place(rank, pose, turns[rank], (0.0, 0.0, 0.0) if rank else tuple(stage.lie(pose)))
            stage.settle()
            scene, scene.ngeom = viewer.user_scn, 0
            above = 1.4 * stage.looks.box[1, 2]
            for rank, name in enumerate(stage.names[1:], start=1):
                geom, rgba = scene.geoms[scene.ngeom], np.array([*ink(name), 255], dtype=np.float32) / 255.0
                place = np.array([*poses[rank][:2], above + 0.12 * stage.looks.scale[2] * rank])
                mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_LABEL, np.full(3, 0.1), place, np.eye(3).ravel(), rgba)
                geom.label = ascii_text(name)[:90]
                scene.ngeom += 1
        places = mujoco.mjtGridPos
        viewer.set_texts([
            (None, places.mjGRID_TOPLEFT, _HELP, ""),
            (None, places.mjGRID_BOTTOMLEFT, ascii_text(status), ""),
        ])  # fmt: skip
        viewer.sync()
