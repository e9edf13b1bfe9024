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

from ssmr.parameters import require_one_of
from validation.output import PICTURES, write_atomic

STYLE = Path(__file__).with_name("style.mplstyle")
"""Style of all pictures, whatever settings their user has."""
WORDS = "words"
"""Mark (gid) of a page's title, notes and foot, which a picture for a paper leaves out."""


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


def write_picture(figure: Figure, path: Path, plain: bool) -> None:
    """Write a figure in the format that the ending of `path` names, see `Report.save_picture`.

    No date stands in it, so equal figures give files that differ at most in ids of an SVG.
    """
    kind = path.suffix.lower()
    require_one_of(kind, PICTURES, f"{path}: a picture ends otherwise than '{kind}'")
    cut = "tight" if plain else None
    for words in figure.findobj(lambda artist: artist.get_gid() == WORDS):
        words.set_visible(not plain)
    # text stays text in a PDF, for editors and searches
    settings = {"pdf.fonttype": 42, "svg.hashsalt": path.name}
    date = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(kind)
    with matplotlib.style.context(["default", STYLE, settings]):
        write_atomic(
            path,
            lambda beside: figure.savefig(
                beside, format=kind[1:], dpi=figure.dpi, bbox_inches=cut, metadata=date
            ),
        )
