"""Lay results of several runs side by side: `python -m validation.table FILE.json …`."""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from validation import cli
from validation.output import Document, write_text
from validation.report.columns import NOTHING
from validation.report.drawing import Panel, PanelRow, ink_of
from validation.report.palette import spell_name
from validation.report.report import Report, Writers
from validation.report.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHOWN = (
    *("source", "robot", "profile", "controller", "reference", "model"),
    *("cost", "train.d_rms_m", "d_rms_m", "sync_rms_m", "yaw_rms_rad"),
    *("metrics.d_rms_m", "metrics.e_y_rms_m", "metrics.cross_track_max_m"),
    *("horizons.6.overlapping.position_median_m", "horizons.6.overlapping.yaw_median_rad"),
    *("before.6.position_median_m", "after.6.position_median_m", "after.6.yaw_median_rad"),
)
"""Columns that are shown where none are named, those of them that the results have."""
_HEADS = ("run", "plant")
"""Columns that name a row."""
_ACROSS = 3
"""Panels side by side in the picture."""
_NO_RESULT = ("tables", "options", "config", "versions", "schema", "notes", "files")
"""Keys that every file has and that no column comes from."""


@dataclass(frozen=True)
class Side(cli.Common):
    """Options of `table`."""

    files: tyro.conf.Positional[Sequence[Path]]
    """JSON files of runs, of one program or of several."""
    columns: Sequence[str] = ()
    """Keys of the columns, such as d_rms_m or horizons.6.position_median_m; the usual ones of the
    program, and parameters that all runs fitted, if not given. A key's beginning may be left out; a
    wrong one lists all."""

    def __post_init__(self) -> None:
        """Raise a ValueError where there is no file, or one twice."""
        super().__post_init__()
        if not 1 <= len(set(self.files)) == len(self.files):
            raise ValueError("name one or more different files, such as runs/fit/a/fit.json")

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        return "table.json", "table.md", "table.csv", "table.png"

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "table"


class SideBySide(Report):
    """Results of several runs in one table, with a row for each run, or each plant of a run."""

    program = "table"
    endings = ("md", "png")

    def files(self) -> Writers:
        """Return writers of the text and of the table as CSV, in SI units."""
        text = self.frame().to_csv(index=False, lineterminator="\n")
        return {**super().files(), "table.csv": lambda path: write_text(path, text)}


@cli.make_program(Side)
def table(o: Side) -> SideBySide:
    """Lay results of several runs side by side.

    Prints one table, with a row for each run, or for each plant of a run, and writes table.json,
    table.md, table.csv and table.png, a bar for each number.

    Raises:
        ValueError: a file is no result, or no result has a column that is named.
    """
    # a run is named after its folder, as far as folders differ
    whole = [Path(os.path.abspath(path)) for path in o.files]
    if len({path.parent for path in whole}) == len(whole):
        whole = [path.parent for path in whole]
    common = os.path.commonpath([path.parent for path in whole])
    rows = []
    for path, place in zip(o.files, whole, strict=True):
        run = place.relative_to(common).as_posix()
        rows += [
            {"run": run, **_flatten_values(values)}
            for values in _result_parts(cli.read_result(path))
        ]
    there = list(dict.fromkeys(key for row in rows for key in row))
    values = [key for key in there if key.startswith("parameters.") and key.endswith(".value")]
    shared = [key for key in values if all(key in row for row in rows)]
    columns = o.columns or (*(name for name in _SHOWN if name in there), *shared)
    heads = [name for name in _HEADS if name in there and name not in columns]
    chosen = [Document() for _ in rows]
    for name in (*heads, *columns):
        named = {name} if name in there else {key for key in there if key.endswith(f".{name}")}
        if not named:
            raise ValueError(f"no result has a '{name}'; there are: {', '.join(there)}")
        for row, shown in zip(rows, chosen, strict=True):
            # the run's own number stands nearer to the top than those of others beside it
            keys = sorted(named & row.keys(), key=lambda key: key.count("."))
            if len(keys) > 1 and keys[0].count(".") == keys[1].count("."):
                raise ValueError(f"'{name}' may be {', '.join(keys)}; write one of them")
            shown[name] = row[keys[0]] if keys else None
    caption = f"{NOTHING} where a run has no such value; --columns chooses"
    if not any(None in row.values() for row in chosen):
        caption = ""
    title = "Results side by side"
    beside = Table(title, chosen, caption)
    about = {"schema": "ssmr.table/1"}
    return SideBySide(title=title, shown=[beside], about=about, panels=_draw_panels(beside))


def _draw_panels(table: Table) -> list[PanelRow]:
    """Return a panel for each column of numbers, with a bar for each row."""
    heads = [[row.get(name) for name in _HEADS] for row in table.rows]
    names = [spell_name(", ".join(filter(None, head))) for head in heads]
    inks = [ink_of(plant or "") for _, plant in heads]

    def draw(title: str, texts: Sequence[str], labels: Sequence[str], ax: Axes) -> None:
        places = range(len(texts))
        ax.barh(places, list(map(_bar_length, texts)), color=inks)
        ax.set(title=title, ylim=(len(texts) - 0.4, -0.6))
        ax.set_yticks(places, labels)

    panels = list[Panel]()
    for column in table.columns():
        if not column.holds_words:
            # the first panel of a row has the names
            labels = [""] * len(names) if len(panels) % _ACROSS else names
            title = f"{column.heading} [{column.unit}]" if column.unit else column.heading
            panels.append(partial(draw, title, column.texts, labels))
    height = 1.0 + 0.25 * len(names)
    return [PanelRow(height, panels[k : k + _ACROSS]) for k in range(0, len(panels), _ACROSS)]


def _bar_length(text: str) -> float:
    """Return the number that a cell has; 0 where it has none."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def _result_parts(document: Document) -> list[Document]:
    """Return what a result has of each of its plants; the whole of one without plants."""
    for key in _NO_RESULT:
        document.pop(key, None)
    plants = document.pop("plants", None)
    if not plants:
        return [document]
    document.pop("parameters", None)  # of all plants
    return [{**document, "plant": name, **values} for name, values in plants.items()]


def _flatten_values(values: Document) -> Document:
    """Return words and numbers by dotted key."""
    flat = Document()
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{key}": part for key, part in _flatten_values(value).items()}
        elif isinstance(value, str | int | float):
            flat[name] = value
    return flat


if __name__ == "__main__":
    table.main()
