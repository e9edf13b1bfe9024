"""A report as one HTML page that needs nothing else: no picture, script, font or style comes from elsewhere."""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from validation.replicate.report import Document
from validation.show.tables import Cell
from validation.thesis.verdicts import STATUSES


def status_class(cell: Cell) -> str:
    """The style of a cell that says a verdict, such as `agrees` or `not-compared`; empty for any other cell."""
    return next((s.replace(" ", "-") for s in STATUSES if cell.text == s or cell.text.startswith((f"{s} [", f"{s}: "))), "")


def prose(text: str) -> Markup:
    """A sentence with its `code` as such, everything escaped."""
    pieces = [escape(piece) for piece in text.split("`")]
    if len(pieces) % 2 == 0:  # a lonely backtick is one
        return escape(text)
    return Markup("").join(Markup("<code>{}</code>").format(p) if k % 2 else p for k, p in enumerate(pieces))


def picture_data(path: Path) -> str:
    """A PNG file as a `data:` URI.

    Raises:
        OSError: it cannot be read.
    """
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


def render(document: Document, figures: Path) -> str:
    """The page.

    Args:
        document: the report; all of its texts are escaped.
        figures: folder in which its pictures lie.

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
