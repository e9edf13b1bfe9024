"""Foreign text leaves the project harmless on every medium.

Nothing raw reaches a terminal, a page, a picture or a name.
"""

from __future__ import annotations

import os
import unicodedata
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from validation import output

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
    return [
        c
        for c in text
        if unicodedata.category(c) in {"Cc", "Cf", "Cs", "Zl", "Zp"} and c not in breaks
    ]


@given(texts)
def test_one_line_is_printable_and_stays_what_it_is(text: str) -> None:
    line = output.one_line(text)
    assert not harmful(line)
    assert output.one_line(line) == line
    line.encode()
    assert not harmful(output.each_line(text), "\n")
    assert not harmful(output.code_span(text))
    assert len(output.shorten_text(text, 20)) <= 20


def test_what_is_not_shown_as_it_is_can_still_be_told_apart() -> None:
    assert output.one_line(os.fsdecode(b"o\xff4.csv")) == r"o\xff4.csv"
    assert output.one_line("a\x1b[2J\u202eb\U000e0041") == r"a\x1b[2J\u202eb\U000e0041"
    assert output.one_line("ü – é 日本") == "ü – é 日本"
    assert output.each_line("a\n  b\x1b\r\nc") == "a\n  b\\x1b\nc"


@given(texts, texts)
def test_markdown_shows_foreign_text_as_text(text: str, other: str) -> None:
    page = "\n".join(
        [
            f"# {output.markdown_text(text)}",
            "",
            f"- {output.markdown_text(other)}",
            "",
        ]
    )
    tokens = MarkdownIt("commonmark").parse(page)
    every = [inner for token in tokens for inner in (token, *(token.children or ()))]
    assert not {token.type for token in every} & {"html_inline", "html_block", "link_open", "image"}


@given(texts)
def test_names_of_files_are_no_paths_and_no_options(text: str) -> None:
    name = output.file_name(text)
    assert Path(name).name == name
    assert name not in {"", ".", ".."}
    assert name[0] not in ".-~ "
    assert len(os.fsencode(name)) <= output.LONGEST_FILE_NAME
    assert not harmful(name)
    assert output.file_name(name) == name


@given(st.text(max_size=80), st.integers(8, 40))
def test_what_is_too_long_loses_its_middle(text: str, most: int) -> None:
    line = output.abridge_text(text, most)
    assert len(line) <= most
    assert not harmful(line, "")
    whole = output.one_line(text)
    assert (
        line == whole
        if len(whole) <= most
        else whole.startswith(line[:3]) and whole.endswith(line[-1:])
    )
