"""A report as one HTML page that contains its pictures and styles, and loads nothing."""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from validation.replicate.report import Document
from validation.show.tables import Cell
from validation.thesis.verdicts import STATUSES


def status_class(cell: Cell) -> str:
    """Return the style of a cell with a verdict, such as `agrees` or `not-compared`; empty for any other cell."""
    return next((s.replace(" ", "-") for s in STATUSES if cell.text == s or cell.text.startswith((f"{s} [", f"{s}: "))), "")


def prose(text: str) -> Markup:
    """Return a sentence as HTML: its `code` in code elements, everything else escaped."""
    pieces = [escape(piece) for piece in text.split("`")]
    if len(pieces) % 2 == 0:  # an unpaired backtick is text
        return escape(text)
    return Markup("").join(Markup("<code>{}</code>").format(p) if k % 2 else p for k, p in enumerate(pieces))


def picture_data(path: Path) -> str:
    """Return a PNG file as a `data:` URI.

    Raises:
        OSError: it cannot be read.
    """
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


def render(document: Document, figures: Path) -> str:
    """Return the page.

    Args:
        document: the report; all of its texts are escaped.
        figures: folder of its pictures.

    Raises:
        OSError: a picture cannot be read.
    """
    environment = Environment(
        loader=PackageLoader("validation.replicate", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["prose"] = prose
    template = environment.get_template("replicate.html")
    return template.render(document=document, status_class=status_class, data=lambda file: picture_data(figures / file))
