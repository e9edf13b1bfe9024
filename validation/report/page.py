"""A report as one HTML page that needs no other file."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from validation.output import markdown_text, one_line
from validation.report.report import Report
from validation.report.table import Table, draw_section, html_of, image_html

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOOK = """
body { max-width: 76rem; margin: 0 auto; padding: 1rem; color: #222;
  font: 16px/1.5 system-ui, sans-serif; }
figure { margin: 0; overflow-x: auto; }
img { max-width: 100%; height: auto; }
@media (max-width: 46em) { img { max-width: none; width: 46em; } }
table { display: block; overflow-x: auto; border-collapse: collapse; font-size: 14px; }
td, th { padding: 0.2rem 0.7rem; border-bottom: 1px solid #ddd; white-space: nowrap; }
pre, code { white-space: pre-wrap; overflow-wrap: anywhere; background: #f4f4f4; }
h1 + p { border-left: 0.4rem solid #d08c00; padding-left: 0.8rem; font-size: 18px; }
"""
"""Style of a page: what is wide scrolls, and pictures stay readable on a narrow screen."""


_NEXT = """## What to do next

- `python -m validation.compare OTHER.csv --profile profile.toml --bands` judges the numbers on
  another drive.
- `python -m validation.track mpc circle --plant mujoco --profile profile.toml` drives with them.
- Numbers that are uncertain, or that cannot be told apart, need other driving: curves to both
  sides, turns on the spot, and changes of speed.
- `diff_drive.yaml` is for the robot's controller. Log its commands again once it has them.
"""


def calibration_page(
    report: Report, kept: Report, tables: Sequence[Table], faults: Sequence[str]
) -> str:
    """Return a calibration as a page that needs no other file, the verdict first.

    Args:
        report: the calibration; its first table has the errors before and after.
        kept: the calibrated simulations along unseen data.
        tables: all tables; those without rows are left out.
        faults: sentences on the log.
    """
    errors, *others = [draw_section(table) for table in tables if table.rows]
    listed = [f"- {markdown_text(fault)}" for fault in faults] or ["None was found."]
    notes = [f"- {markdown_text(note)}" for note in report.notes()]
    parts: list[str | Figure] = [
        "\n".join([f"# {markdown_text(report.title)}", "", markdown_text(report.verdict())]),
        "## Paths of unseen data",
        kept.figure(),
        "\n".join(errors),
        report.figure(),
        *map("\n".join, others),
        "\n".join(["## Faults of the log", "", *listed, "", "## Notes", "", *notes, "", _NEXT]),
    ]
    return _html_page(one_line(report.title), parts)


def _html_page(title: str, parts: Iterable[str | Figure]) -> str:
    """Return a page of pieces of markdown and of figures, which are inside it as PNG."""
    from validation.report.picture import png_of

    body = ""
    for part in parts:
        if isinstance(part, str):
            body += html_of(part)
            continue
        body += f"<figure>{image_html(png_of(part), title)}</figure>\n"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_LOOK}</style></head>\n"
        f"<body>{body}</body></html>\n"
    )
