"""OpenGL without a window: a context that draws into memory, by whichever library of this machine can make one."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any

from ssmr.errors import SsmrError
from validation.words import one_line

_PLATFORM = "PYOPENGL_PLATFORM"
_KINDS = ("egl", "osmesa", "glfw")
_HOW_TO_GET_IT = "install EGL or OSMesa (Debian, Ubuntu: apt install libegl1 libegl-mesa0, or libosmesa6)"


class NoGraphicsError(SsmrError):
    """Nothing can be drawn on this machine; the message says what to install."""


def open_graphics(width: int, height: int) -> Any:
    """Return a current OpenGL context for pictures of a size [pixels]; the caller calls its `free()`.

    On Linux EGL, OSMesa and, where there is a screen, GLFW are tried in this order, or only the one that the environment
    variable MUJOCO_GL names. MuJoCo itself looks at that variable once, when it is imported, and takes GLFW without it.

    Raises:
        NoGraphicsError: none of them works.
    """
    if not sys.platform.startswith("linux"):
        return _opened("gl_context", width, height)
    wanted, screen = os.environ.get("MUJOCO_GL", "").lower(), os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    kinds = (wanted,) if wanted in _KINDS else _KINDS if screen else _KINDS[:-1]
    failed = []
    for kind in kinds:
        before = os.environ.get(_PLATFORM)
        try:
            return _opened(kind, width, height)
        except Exception as error:  # noqa: BLE001 - a library that is missing and a driver that is broken fail in many ways
            failed.append(f"{kind}: {one_line(error)[:100]}")
            _forget(kind, before)
    raise NoGraphicsError(f"no OpenGL works here ({'; '.join(failed)}); {_HOW_TO_GET_IT}")


def _opened(module: str, width: int, height: int) -> Any:
    context = import_module(f"mujoco.{module}").GLContext(width, height)
    context.make_current()
    return context


def _forget(kind: str, platform: str | None) -> None:
    """Let the next library be tried as if this one had not been: PyOpenGL chooses its platform when it is imported."""
    if platform is None:
        os.environ.pop(_PLATFORM, None)
    for name in [n for n in sys.modules if n.partition(".")[0] == "OpenGL" or n.startswith(f"mujoco.{kind}")]:
        del sys.modules[name]
