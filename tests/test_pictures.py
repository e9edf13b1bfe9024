"""Every picture of README and of the pages has a stamp of the code that drew it, and a script."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path
from typing import Any

import pytest
from PIL import ExifTags, Image

from tests.appendices import gone_rooms, is_deleted
from validation.cli.__main__ import PROGRAMS

pytestmark = pytest.mark.usefixtures("with_drawings")

DOCS = Path(__file__).resolve().parents[1] / "docs"
DRAWN: dict[str, Any] = {
    f"{name}.{made.ending}": made
    for name, made in runpy.run_path(str(DOCS / "pictures.py"))["PICTURES"].items()
}
STAMP = r"ssmr-testbed \d+\.\d+\.\d+(\.dev\d+)?, commit [0-9a-f]{7,40}"


def test_every_picture_has_its_command() -> None:
    files = {
        str(file.relative_to(DOCS / "img")) for file in (DOCS / "img").rglob("*") if file.is_file()
    }
    assert set(DRAWN) == files


@pytest.mark.parametrize("file", DRAWN)
def test_what_draws_a_picture_is_there(file: str) -> None:
    program, *arguments = shlex.split(DRAWN[file].command)
    if not program.endswith(".py"):
        assert program in PROGRAMS or is_deleted(DOCS.parent / "validation" / program)
        return
    assert (DOCS / program).is_file() or is_deleted(DOCS / program)
    if program == "make_gallery.py":
        assert (DOCS.parent / "examples" / arguments[0]).is_file()


@pytest.mark.parametrize("file", [file for file in DRAWN if not file.endswith(".svg")])
def test_a_picture_says_which_code_drew_it(file: str) -> None:
    """The picture of the rooms is an SVG without such data; another test draws it anew."""
    with Image.open(DOCS / "img" / file) as picture:
        exif = picture.getexif()
    assert exif.get(ExifTags.Base.ImageDescription) == DRAWN[file].command
    assert re.fullmatch(STAMP, exif.get(ExifTags.Base.Software, ""))


@pytest.mark.skipif(bool(gone_rooms()), reason="the pages of an appendix were deleted")
def test_every_picture_is_shown() -> None:
    pages = [DOCS.parent / "README.md", *DOCS.glob("*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    assert {file for file in DRAWN if f"img/{file})" not in text} == set()
