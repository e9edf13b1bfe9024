"""`python -m validation.track CONTROLLER REFERENCE`: a closed loop around any plant, held against its reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from validation import store
from validation.track.gains import DEFAULT, names
from validation.track.report import as_document
from validation.track.result import TrackResult

DEFAULT_SPEED = 0.25
"""Of the named references [m/s]; the slower of the thesis' two."""
NAMED = ("line", "circle", "sine", "generic")


def write(results: Sequence[TrackResult], folder: Path, *, recording: bool = True) -> list[Path]:
    """Write track.png, track.rrd (if wanted) and, last, track.json; return what was written."""
    from validation.show.drawing import save_figure
    from validation.track.figure import draw_track

    written = [folder / "track.png"]
    save_figure(draw_track(results), written[0])
    if recording:
        from validation.track.rerun import write_track_rerun

        written.append(folder / "track.rrd")
        write_track_rerun(results, written[-1])
    written.append(folder / "track.json")
    store.write_json(written[-1], as_document(results))
    return written


def default_gains(controller: str) -> str:
    """`published` where the thesis has gains for that controller, else `tuned`, else the defaults of the law."""
    there = names(controller)
    return next((name for name in ("published", "tuned") if f"{controller}-{name}" in there), DEFAULT)
