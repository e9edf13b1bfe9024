"""Foreign text leaves the project harmless on every medium: nothing raw reaches a terminal, a page, a picture or a name."""

from __future__ import annotations

import codecs
import io
import logging
import os
import unicodedata
import warnings
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from matplotlib.axes import Axes
from rich.console import Console

from validation import cli, words
from validation.cli import process, running
from validation.report import drawing
from validation.report.tables import Cell, Grid, markdown_table, rich_table, text_tables

NASTY = (
    "\x1b[31mred\x1b[0m",
    "a\x00b\x07\x7f\x9b2J",
    "\udcff\udc80",
    "\u202egnp.exe\u2066",
    "[/x][red]o[/red]2",
    "a$b$c_{`",
    "<script>alert(1)</script>",
    "[x](javascript:alert(1))![y](http://z)",
    "\\<b>\\](x)\\|",
    "a|b\\|c",
    "line\nbreak\r\n# heading\u2028\u2029",
    "..",
    "-rf",
    "../../etc",
    "x" * 300,
    "\U000e0041\u200b\ufeff",
    "日本 😀",
)
texts = st.text(st.characters(codec=None), max_size=60) | st.sampled_from(NASTY)


def harmful(text: str, breaks: str = "") -> list[str]:
    """Return the characters of a text that no terminal should get."""
    return [c for c in text if unicodedata.category(c) in {"Cc", "Cf", "Cs", "Zl", "Zp"} and c not in breaks]


@given(texts)
def test_one_line_is_printable_and_stays_what_it_is(text: str) -> None:
    line = words.one_line(text)
    assert not harmful(line)
    assert words.one_line(line) == line
    line.encode()
    assert not harmful(words.each_line(text), "\n")
    assert not harmful(words.code_span(text))
    assert len(words.shortened(text, 20)) <= 20


def test_what_is_not_shown_as_it_is_can_still_be_told_apart() -> None:
    assert words.one_line(os.fsdecode(b"o\xff4.csv")) == r"o\xff4.csv"
    assert words.one_line("a\x1b[2J\u202eb\U000e0041") == r"a\x1b[2J\u202eb\U000e0041"
    assert words.one_line("ü – é 日本") == "ü – é 日本"
    assert words.each_line("a\n  b\x1b\r\nc") == "a\n  b\\x1b\nc"


@given(texts, texts)
def test_markdown_shows_foreign_text_as_text(text: str, other: str) -> None:
    page = "\n".join([
        f"# {words.markdown(text)}",
        "",
        f"- {words.markdown(other)}",
        "",
        *markdown_table(Grid((("name", ""), (text, "m")), (((Cell(text), Cell(other, best=True)),),), 1)),
    ])  # fmt: skip
    parser = MarkdownIt("commonmark").enable("table")
    tokens = parser.parse(page)
    every = [inner for token in tokens for inner in (token, *(token.children or ()))]
    assert not {token.type for token in every} & {"html_inline", "html_block", "link_open", "image"}
    cells = [token.type for token in tokens].count("td_open"), [token.type for token in tokens].count("th_open")
    assert cells == (2, 2)


@given(texts)
def test_names_of_files_are_no_paths_and_no_options(text: str) -> None:
    name = words.file_name(text)
    assert Path(name).name == name
    assert name not in {"", ".", ".."}
    assert name[0] not in ".-~ "
    assert len(os.fsencode(name)) <= words.LONGEST_FILE_NAME
    assert not harmful(name)
    assert words.file_name(name) == name


def test_usual_names_stay_and_different_ones_differ() -> None:
    for name in ("traj4", "traj4@mujoco", "drive 2024-05-01", "größe", "drive-ramp-5,toward=30", "mujoco-a+b"):
        assert words.file_name(name) == name
    assert len({words.file_name(name) for name in (*NASTY, "a:b", "a?b", "a_b", "x" * 301)}) == len(NASTY) + 4


@given(texts)
def test_tables_hold_foreign_text_as_it_is(text: str) -> None:
    grid = Grid(((text, "m"), ("b", text)), (((Cell(text), Cell(text, best=True)),),), 1, text, text)
    assert not harmful(text_tables([grid], [text], width=400), "\n")


def test_tables_come_out_on_an_ascii_terminal() -> None:
    """The command lines put `ascii_text` behind their streams; tables choose a box of ASCII by the stream's encoding."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="spelt")
    grid = Grid((("distance", "µm"), ("m/s²", "")), (((Cell("– × 5 °"), Cell("é日")),),), 1, "a · b", "…")
    codecs.register_error("spelt", process._spell)
    Console(file=stream, width=80).print(rich_table(grid))
    stream.flush()
    said = stream.buffer.getvalue().decode("ascii")  # type: ignore[attr-defined]
    for part in ("um", "m/s2", "- x 5  deg", r"e\u65e5", "a * b", "...", "-----"):
        assert part in said
    assert "?" not in said


@given(texts)
def test_every_text_can_be_spelt_in_ascii(text: str) -> None:
    said = words.ascii_text(words.one_line(text))
    assert said.isascii()
    assert said.isprintable()


def test_pictures_draw_any_text(tmp_path: Path) -> None:
    whole = "\n".join(NASTY)

    def panel(ax: Axes) -> None:
        ax.plot([0.0, 1.0])
        ax.set(title=whole, xlabel=whole)
        ax.set_xticks([0.0, 1.0], [whole, "b"])
        ax.annotate(whole, (0.0, 0.0))
        drawing.line_legend(ax, ax.lines, [whole])
        drawing.narrow(ax.text(0.0, 0.0, whole), 2.0)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = [drawing.text_row(0.3, partial(drawing.draw_section, whole)), drawing.side_by_side(3.0, [panel])]
        figure = drawing.put_together([*rows, *drawing.note_rows(list(NASTY))])
        for ending in ("png", "svg", "pdf"):
            drawing.save_figure(figure, tmp_path / f"picture.{ending}")
    assert not harmful((tmp_path / "picture.svg").read_text(encoding="utf-8"), "\n\t")
    assert drawing.drawable("a$b\udcff 日") == "a$b\\xff □"


class _Elements(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found |= {tag, *(name for name, _ in attrs)}


@pytest.mark.parametrize("text", NASTY)
def test_the_page_of_a_replication_holds_foreign_text_as_text(text: str, tmp_path: Path) -> None:
    from validation.replicate.evidence import Picture
    from validation.replicate.report import Chapter, Document, document_html, document_markdown

    (tmp_path / "a.png").write_bytes(b"png")
    grid = Grid((("a", text),), (((Cell(text),),),), 1, text, text)
    picture = Picture("a.png", f'{text}" onerror="x')
    document = Document(text, (text, f"`{text}`"), grid, (Chapter("key", text, (text,), (), (picture,)),), text)
    page, report = document_html(document, tmp_path), document_markdown(document, "img/")
    for written in (page, report):
        written.encode()
        assert not harmful(written, "\n")
    elements = _Elements()
    elements.feed(page)
    assert not elements.found & {"script", "b", "onerror"}


def test_the_log_passes_no_escape_sequence_on(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    running._prepare_log()
    logging.getLogger("validation.test").warning("a topic %s was dropped", "/x\x1b]0;title\x07[red]\udcff")
    said = " ".join(capfd.readouterr().err.split())
    assert said == r"WARNING a topic /x\x1b]0;title\x07[red]\xff was dropped"


@given(st.text(max_size=80), st.integers(8, 40))
def test_what_is_too_long_loses_its_middle(text: str, most: int) -> None:
    line = words.abridged(text, most)
    assert len(line) <= most
    assert not harmful(line, "")
    whole = words.one_line(text)
    assert line == whole if len(whole) <= most else whole.startswith(line[:3]) and whole.endswith(line[-1:])


def test_paths_are_told_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    class Nothing:
        def grids(self) -> tuple[()]:
            return ()

        notes = grids

    cli.report_result(Nothing(), [Path(" /a.png"), Path("a\tb/c.png"), Path("o[red]2/d.png")])
    assert capsys.readouterr().out == "written:  /a.png, a\\tb/c.png, o[red]2/d.png\n"
