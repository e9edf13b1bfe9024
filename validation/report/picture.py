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
from matplotlib.lines import Line2D
from matplotlib.text import Text
from PIL import Image

from ssmr.parameters import require_one_of
from validation.output import PICTURES, write_atomic

STYLE = Path(__file__).with_name("style.mplstyle")
"""Style of all pictures, whatever settings their user has."""
WORDS = "words"
"""Mark (gid) of a page's title, notes and foot, which a picture for a paper leaves out."""

PAPER_IN = 7.16
"""Width of a picture for a paper: two columns of most journals [in]."""
PAPER_SHARE = 0.72
"""Size of its letters and lines over that on a page: 7 points or more."""


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
    cut = None
    if plain:
        cut = "tight"
        _fit_paper(figure)
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


def _fit_paper(figure: Figure) -> None:
    """Leave out what a paper says in its own words, and make a page as wide as two columns."""
    for words in figure.findobj(lambda artist: artist.get_gid() == WORDS):
        words.set_visible(False)
    for text in figure.findobj(Text):
        text.set_fontsize(PAPER_SHARE * float(text.get_fontsize()))
    for line in figure.findobj(Line2D):
        line.set_linewidth(PAPER_SHARE * line.get_linewidth())
        line.set_markersize(PAPER_SHARE * line.get_markersize())
    for part in figure.subfigs:
        # what is empty would stay as a strip
        part.set_visible(bool(part.axes or part.legends))
    height = figure.get_figheight()
    figure.set_size_inches(PAPER_IN, PAPER_SHARE * height)
    for ax in figure.axes:
        # a place that was set is left out of a layout
        ax.set_in_layout(True)
    figure.set_layout_engine("constrained")
