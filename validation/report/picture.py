"""Pictures that a notebook shows.

This module imports matplotlib; others import it where something is drawn.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

STYLE = Path(__file__).with_name("style.mplstyle")
"""Style of all pictures, whatever settings their user has."""


class Picture(Figure):
    """A figure that a notebook shows, though no window of pyplot has it."""

    def _repr_png_(self) -> bytes:
        return png_of(self)


def png_of(figure: Figure) -> bytes:
    """Return a figure as PNG: the pixels that it was drawn with, if nothing changed since."""
    file = BytesIO()
    canvas = figure.canvas
    if isinstance(canvas, FigureCanvasAgg) and not figure.stale:
        pixels = Image.fromarray(np.asarray(canvas.buffer_rgba()))
        pixels.save(file, format="png", dpi=(figure.dpi, figure.dpi), compress_level=1)
    else:
        with matplotlib.style.context(["default", STYLE]):
            figure.savefig(file, format="png", dpi=figure.dpi)
    return file.getvalue()
