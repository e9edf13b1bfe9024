"""Flat-shaded triangles as an image, each pixel showing what is nearest to the eye."""

from __future__ import annotations

import numpy as np

from ssmr.types import FloatArray

SUPERSAMPLED = 2
"""Samples along a side of each pixel."""


def rasterised(
    flat: FloatArray, depth: FloatArray, colours: FloatArray, span: FloatArray, shape: tuple[int, int]
) -> FloatArray:
    """Return an (H, W, 4) image of triangles, rows from the lower edge up, transparent where there is none.

    Args:
        flat: (T, 3, 2) corners in the plane of the image.
        depth: (T, 3) how near the corners are to the eye; the greatest is seen.
        colours: (T, 3) red, green, blue, 0 to 1.
        span: (2, 2) coordinates of the lower left and the upper right corner of the image.
        shape: rows and columns of the image.
    """
    tall, wide = (SUPERSAMPLED * n for n in shape)
    image, nearest = np.zeros((tall, wide, 4)), np.full((tall, wide), -np.inf)
    pixels = (flat - span[0]) / (span[1] - span[0]) * np.array([wide, tall]) - 0.5
    low = np.clip(np.ceil(pixels.min(axis=1)), 0, [wide, tall]).astype(int)
    high = np.clip(np.floor(pixels.max(axis=1)) + 1, 0, [wide, tall]).astype(int)
    for corners, near, colour, (x0, y0), (x1, y1) in zip(pixels, depth, colours, low, high, strict=True):
        if x0 >= x1 or y0 >= y1:
            continue
        (ax, ay), (bx, by), (cx, cy) = corners
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        x, y = np.arange(x0, x1)[None, :], np.arange(y0, y1)[:, None]
        of_b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        of_c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        of_a = 1.0 - of_b - of_c
        here = of_a * near[0] + of_b * near[1] + of_c * near[2]
        there = nearest[y0:y1, x0:x1]
        shown = (of_a >= -1e-9) & (of_b >= -1e-9) & (of_c >= -1e-9) & (here > there)
        there[shown] = here[shown]
        image[y0:y1, x0:x1][shown] = (*colour, 1.0)
    n = SUPERSAMPLED
    blocks = image.reshape(shape[0], n, shape[1], n, 4).sum(axis=(1, 3))
    filled = np.maximum(blocks[..., 3:], 1.0)
    averaged: FloatArray = np.concatenate([blocks[..., :3] / filled, blocks[..., 3:] / n**2], axis=-1)
    return averaged
