"""Sections of a replication on disk: whatever was changed in them is noticed, and the section is run again."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ssmr.errors import SsmrError
from validation.replicate import Replication, ReplicationSettings, keeping
from validation.replicate.evidence import FIGURE_FOLDER, SECTION_FOLDER, Answer, Context, Findings, Picture, Section, Table
from validation.replicate.keeping import keep, kept, picture_bytes
from validation.replicate.report import document_markdown, document_of
from validation.report.tables import Cell, Grid
from validation.thesis.verdicts import Pair

SETTINGS, DIGEST = ReplicationSettings(), "0" * 64
PNG = b"\x89PNG\r\n\x1a\nno more"
FOUND = Findings(
    {
        "3.8": Table(
            "parameters", {"mu": {"value": Pair(0.3, 0.4, "spread", "1", 0.1, {"lower": 0.0, "upper": 1.0}, "why")}}
        ),
        "3.9": Table("distances", {"traj1": {"d_rms_m": Pair(0.1, 2.0, "at_least", "m", None, {"at_least": 1.0})}}),
    },
    {"a grid": Grid((("name", ""), ("value", "m")), (((Cell("a"), Cell("1.0", True)),),), 1, "title", "caption", 1)},
    ("a note",),
    (Picture("fake-a.png", "a caption"),),
    {"a": [1.0, None, {"b": "c"}]},
)
SECTION = Section("fake", "A section", ("3.8", "3.9"), ("seed",), lambda context: FOUND)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one kept section."""
    out = tmp_path / "out"
    for name in (SECTION_FOLDER, FIGURE_FOLDER):
        (out / name).mkdir(parents=True)
    (out / FIGURE_FOLDER / "fake-a.png").write_bytes(PNG)
    keep(Context(SETTINGS, out, "fake", DIGEST, 1), Answer(SECTION, FOUND, 1.0, 2.0))
    return out


def section_file(folder: Path) -> Path:
    return folder / SECTION_FOLDER / "fake.json"


def edit(folder: Path, change: Callable[[dict[str, Any]], object], *, sign: bool = False) -> None:
    """Change a kept section; with `sign`, as somebody does who knows how the digest is made."""
    document = json.loads(section_file(folder).read_text(encoding="utf-8"))
    change(document)
    if sign:
        document["content"] = keeping._content(document, folder)
    section_file(folder).write_text(json.dumps(document), encoding="utf-8")


def test_what_is_kept_comes_back(folder: Path) -> None:
    assert kept(folder, SECTION, DIGEST) == Answer(SECTION, FOUND, 1.0, 2.0)
    assert kept(folder, SECTION, "1" * 64) is None


def test_an_edited_number_is_noticed_and_said(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    edit(folder, lambda d: d["findings"]["tables"]["3.8"]["rows"]["mu"]["value"].update(ours=0.3))
    assert kept(folder, SECTION, DIGEST) is None
    assert "were changed after they were written; the section is run again" in caplog.text


def test_an_edited_effort_and_an_exchanged_picture_are_noticed(folder: Path) -> None:
    whole = section_file(folder).read_bytes()
    edit(folder, lambda d: d["effort"].update(wall_s=0.1))
    assert kept(folder, SECTION, DIGEST) is None
    section_file(folder).write_bytes(whole)
    assert kept(folder, SECTION, DIGEST) is not None
    (folder / FIGURE_FOLDER / "fake-a.png").write_bytes(PNG + b"!")
    assert kept(folder, SECTION, DIGEST) is None


NAMES = [
    "../../../secret.txt", "../secret.png", "/etc/secret.png", "a/b.png", "..", "", ".png", "a\0.png", "a.svg", "a.png\n",
    "\\\\host\\a.png", "é.png",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_has_a_plain_name(folder: Path, name: str) -> None:
    (folder / "secret.png").write_bytes(b"secret")
    with pytest.raises(ValueError, match="is no name of a picture"):
        Picture(name, "a caption")
    with pytest.raises(ValueError, match="is no name of a picture"):
        picture_bytes(folder / FIGURE_FOLDER, name)
    edit(folder, lambda d: d["findings"]["pictures"][0].update(file=name))
    assert kept(folder, SECTION, DIGEST) is None


def test_a_link_does_not_lead_out_of_the_folder(folder: Path) -> None:
    (folder / "secret.txt").write_bytes(PNG)
    picture = folder / FIGURE_FOLDER / "fake-a.png"
    picture.unlink()
    picture.symlink_to(folder / "secret.txt")
    with pytest.raises(SsmrError, match="leads out of the folder"):
        picture_bytes(folder / FIGURE_FOLDER, "fake-a.png")
    assert kept(folder, SECTION, DIGEST) is None
    replication = Replication(SETTINGS, folder, (Answer(SECTION, FOUND, 1.0, 2.0),))
    for write in (lambda: replication.save(folder), lambda: replication.publish(folder / "docs.md")):
        with pytest.raises(SsmrError, match="leads out of the folder"):
            write()


@pytest.mark.parametrize("what", ["ring", "pipe", "missing"])
def test_a_picture_that_is_none_is_one_line(folder: Path, what: str) -> None:
    picture = folder / FIGURE_FOLDER / "fake-a.png"
    picture.unlink()
    if what == "ring":
        picture.symlink_to(picture)
    if what == "pipe":
        os.mkfifo(picture)
    with pytest.raises(SsmrError, match=r"fake-a\.png"):
        picture_bytes(folder / FIGURE_FOLDER, "fake-a.png")
    assert kept(folder, SECTION, DIGEST) is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "3",
        '"a"',
        "NaN",
        '{"schema": "ssmr.evidence/2"}',
        "[" * 100_000,
        '{"schema": 1e999}',
        "\ud800",
    ],
)
def test_what_is_no_section_is_run_again(folder: Path, text: str) -> None:
    section_file(folder).write_bytes(text.encode("utf-8", "surrogatepass"))
    assert kept(folder, SECTION, DIGEST) is None


def test_neither_a_pipe_nor_a_huge_file_is_a_section(folder: Path) -> None:
    section_file(folder).unlink()
    os.mkfifo(section_file(folder))
    assert kept(folder, SECTION, DIGEST) is None
    section_file(folder).unlink()
    with section_file(folder).open("wb") as stream:
        stream.truncate(8 << 30)
    assert kept(folder, SECTION, DIGEST) is None


def places(value: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every part of a document."""
    if way:
        yield way
    for key, part in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(part, (*way, key))


JUNK: list[Any] = [None, True, 0, -1, 1e308, 2**62, "", "x", "../x", [], {}, [[]], {"x": 1}, [None], {"": {}}]


@pytest.mark.parametrize("junk", JUNK, ids=repr)
def test_no_value_in_any_place_is_a_traceback(folder: Path, junk: Any) -> None:
    """Each part of the file is replaced, and signed: it is refused, or can be shown."""
    text = section_file(folder).read_text(encoding="utf-8")
    for way in places(json.loads(text)):

        def put(document: Any, way: tuple[Any, ...] = way) -> None:
            for key in way[:-1]:
                document = document[key]
            document[way[-1]] = junk

        section_file(folder).write_text(text, encoding="utf-8")
        try:
            edit(folder, put, sign=way[0] != "content")
        except (ValueError, SsmrError, TypeError, KeyError):
            edit(folder, put)  # nobody can sign this
        answer = kept(folder, SECTION, DIGEST)
        if answer is not None:
            assert document_markdown(document_of([answer], SETTINGS), "figures/")
            json.dumps(Replication(SETTINGS, folder, (answer,)).as_dict(), allow_nan=False)
