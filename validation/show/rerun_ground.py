"""The ground as rerun shows it: level, uneven, of two frictions, or with an arrow down its slope."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr

from validation.robots.terrain import Terrain
from validation.show.palette import Rgb

GROUND: Rgb = (222, 225, 229)
OTHER_GROUND: Rgb = (160, 188, 214)
DOWNHILL: Rgb = (110, 90, 60)
BELOW = 0.004
"""Distance by which the ground is drawn too low, so that lines on it show [m]."""
MOST_POINTS = 200
"""Along a side of uneven ground."""
LIGHT = np.array([0.45, -0.25, 0.86])
"""Direction of the light by which uneven ground is shaded; steep light, so that low bumps show."""
SHADING = 6.0
"""Factor by which shades exaggerate a slope."""


def write_ground(recording: rr.RecordingStream, entity: str, terrain: Terrain, low: np.ndarray, high: np.ndarray) -> None:
    """Log the ground between two corners [m], just below the lines that are drawn on it."""
    if terrain.kind == "rough":
        recording.log(entity, _uneven(terrain, low, high), static=True)
        return
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    recording.log(entity, _sheet(corners, -BELOW, GROUND), static=True)
    if terrain.kind == "split":
        reach = float(np.hypot(*(high - low)))
        along = np.array([math.cos(terrain.edge_heading), math.sin(terrain.edge_heading)])
        right = np.array([along[1], -along[0]])
        middle = 0.5 * (low + high)
        start = middle + (-terrain.edge_offset - middle @ right) * right
        half = [start - 0.5 * reach * along, start - 0.5 * reach * along + 0.5 * reach * right]
        half += [start + 0.5 * reach * along + 0.5 * reach * right, start + 0.5 * reach * along]
        recording.log(f"{entity}/other", _sheet(half, -0.5 * BELOW, OTHER_GROUND), static=True)
    if terrain.kind == "ramp" and terrain.slope > 0.0:
        downhill = -np.array([math.cos(terrain.toward), math.sin(terrain.toward), 0.0])
        words, origin = f"downhill, {math.degrees(terrain.slope):g}°", [0.0, 0.0, 0.02]
        arrow = rr.Arrows3D(origins=[origin], vectors=[1.2 * downhill], colors=[DOWNHILL], radii=[0.02], labels=[words])
        recording.log(f"{entity}/downhill", arrow, static=True)


def _sheet(corners: list, z: float, rgb: Rgb) -> rr.Mesh3D:
    return rr.Mesh3D(
        vertex_positions=[(float(x), float(y), z) for x, y in corners],
        triangle_indices=[(0, 1, 2), (0, 2, 3)],
        vertex_normals=[(0.0, 0.0, 1.0)] * 4,
        vertex_colors=[rgb] * 4,
    )


def _uneven(terrain: Terrain, low: np.ndarray, high: np.ndarray) -> rr.Mesh3D:
    """A net over the ground, shaded by its slopes, which would hardly show at their true size."""
    n = [int(min(MOST_POINTS, max(2, math.ceil((b - a) / (0.2 * terrain.length))))) for a, b in zip(low, high, strict=True)]
    x, y = (np.linspace(a, b, k) for a, b, k in zip(low, high, n, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    surface = terrain.surface.at(points)
    normals = np.column_stack([-SHADING * surface[:, 1:], np.ones(len(points))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    shade = np.clip(normals @ LIGHT / LIGHT[2], 0.55, 1.12)
    corner = (np.arange(n[1] - 1)[:, None] * n[0] + np.arange(n[0] - 1)).reshape(-1)
    triangles = np.vstack([
        np.column_stack([corner, corner + 1, corner + n[0] + 1]),
        np.column_stack([corner, corner + n[0] + 1, corner + n[0]]),
    ])  # fmt: skip
    return rr.Mesh3D(
        vertex_positions=np.column_stack([points, surface[:, 0] - BELOW]),
        triangle_indices=triangles,
        vertex_normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        vertex_colors=np.clip(shade[:, None] * np.array(GROUND), 0, 255).astype(np.uint8),
    )
