"""Plots of a rerun recording, and the arrangement of its views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import rerun.blueprint as rrb  # after rerun_file, which switches its analytics off

from ssmr.geometry import shift_reference
from ssmr.types import FloatArray
from validation.report.palette import Rgb
from validation.report.rerun_file import TIMELINE, rr
from validation.report.rerun_robots import GRID, Extent, Track
from validation.report.robot_mesh import robot_mesh
from validation.report.thinning import note, outline_of
from validation.words import one_line

_LEGEND_SHARE = 0.4
"""Room right of the plots, over their duration, so that legends hide no line."""
_SKY: Rgb = (238, 240, 243)


@dataclass(frozen=True, eq=False)
class Series:
    """Lines of one entity: k values over the same stamps. Of very many samples it keeps those that outline the lines."""

    names: Sequence[str]
    """k names, with unit."""
    colours: Sequence[Rgb]
    t: FloatArray
    """(M,) [s]."""
    values: FloatArray
    """(M,) or (M, k)."""
    held: bool = False
    """True where each value holds until the next, as commands do."""
    samples: int = field(init=False)
    """Number of samples that there were."""

    def __post_init__(self) -> None:
        """Keep what is drawn: copies, so that the rest can be forgotten."""
        kept = outline_of(self.values)
        for name, value in (("samples", len(self.t)), ("t", self.t[kept]), ("values", self.values[kept])):
            object.__setattr__(self, name, value)


def write_series(recording: rr.RecordingStream, entity: str, series: Series, gaps: FloatArray) -> None:
    """Send the samples; at each instant of `gaps` [s] the lines are interrupted."""
    mode = rr.components.InterpolationMode.StepAfter if series.held else rr.components.InterpolationMode.Linear
    names, colours = list(map(one_line, series.names)), list(series.colours)
    widths = [1.0 if series.held else 1.5] * len(names)
    style = rr.SeriesLines(names=names, colors=colours, widths=widths, interpolation_mode=mode)
    recording.log(entity, style, static=True)
    time = rr.TimeColumn(TIMELINE, duration=series.t)
    recording.send_columns(entity, [time], rr.Scalars.columns(scalars=series.values))
    if len(gaps):
        time = rr.TimeColumn(TIMELINE, duration=gaps)
        recording.send_columns(entity, [time], rr.Clear.columns(is_recursive=[False] * len(gaps)))


def thinning_note(tracks: Sequence[Track], plots: Mapping[str, Series]) -> str:
    """Return a paragraph that says how a recording of these robots and plots is thinned; empty where it is not."""
    period = max(track.pose_period for track in tracks)
    return note(period, max((series.samples for series in plots.values()), default=0))


def plot_view(plots: Mapping[str, Series], entity: str, title: str, span: tuple[float, float]) -> list[rrb.TimeSeriesView]:
    """A view of all series below `plots/<entity>` from the first to the last instant [s], with room for a legend.

    Empty where there is no such series.
    """
    drawn = [series.values for name, series in plots.items() if f"{name}/".startswith(f"{entity}/")]
    if not drawn:
        return []
    at, duration = rr.TimeRangeBoundary.absolute, max(span[1] - span[0], 0.1)
    shown = rr.TimeRange(start=at(seconds=span[0]), end=at(seconds=span[0] + (1.0 + _LEGEND_SHARE) * duration))
    x, y = rrb.TimeAxis(view_range=shown), rrb.ScalarAxis(range=axis_range(drawn))
    legend = rrb.Corner2D.RightTop
    return [rrb.TimeSeriesView(origin=f"/plots/{entity}", name=title, axis_x=x, axis_y=y, plot_legend=legend)]


def blueprint(left: rrb.Container, plots: Sequence[Sequence[rrb.TimeSeriesView]]) -> rrb.Blueprint:
    """Looks at robots on the left, on the right groups of plots above one another, a group's in tabs; it plays at once."""
    right = rrb.Vertical(*(rrb.Tabs(*views) for views in plots if views))
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[8, 5]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="playing", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def axis_range(drawn: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the least and the greatest value on an axis.

    The viewer would take in a zero wherever a line is interrupted, and write numbers only at whole powers of ten where finer
    ones have no room: a range that holds but one of those is widened to the next.
    """
    low, high = min(float(v.min()) for v in drawn), max(float(v.max()) for v in drawn)
    step = 10.0 ** math.floor(math.log10(max(high - low, 1e-3)))
    if high - low > 1.3 * step and math.floor(high / step) - math.ceil(low / step) < 1:
        low, high = step * math.floor(low / step), step * math.ceil(high / step)
    margin = 0.05 * max(high - low, 1e-3)
    return low - margin, high + margin


def view(name: str, origin: str, looks: rrb.EyeControls3D, without: Sequence[str] = ()) -> rrb.Spatial3DView:
    """Return a view of everything below `origin`, seen by an eye."""
    grid = rrb.LineGrid3D(visible=origin == "/world", spacing=1.0, stroke_width=1.0, color=GRID)
    seen = [f"{origin}/**", *without]
    return rrb.Spatial3DView(name=name, origin=origin, contents=seen, background=_SKY, line_grid=grid, eye_controls=looks)


def overviews(extent: Extent, names: Sequence[str]) -> list[rrb.Spatial3DView]:
    """Return views of the world: from aside and, without the `names`, from above."""
    middle = np.append(extent.middle + 0.6 * extent.post * extent.along, 0.0)
    aside = middle + extent.distance * np.append(-math.cos(0.6) * extent.across, math.sin(0.6))
    high = middle + np.array([0.0, 0.0, 1.1 * extent.distance])
    return [
        view("Scene (grid 1 m)", "/world", eye(aside, middle)),
        view("From above", "/world", eye(high, middle, up=np.append(extent.across, 0.0)), names),
    ]


def follower(track: Track, without: Sequence[str]) -> rrb.Spatial3DView:
    """Return a view of the world from close behind a robot."""
    start, scale = track.pose[0], float(robot_mesh(track.robot).scale[:2].max())
    behind = np.append(shift_reference(start, (-1.5 * scale, -1.2 * scale))[:2], 1.15 * scale)
    looks = eye(behind, np.append(start[:2], 0.2 * scale), follow=f"/world/{track.name}/robot/base")
    return view(f"Following {track.name}", "/world", looks, without)


def eye(
    position: FloatArray, target: FloatArray, up: FloatArray | None = None, follow: str | None = None
) -> rrb.EyeControls3D:
    """Return an eye that turns about `target`, which stays where it is unless an entity is to be followed."""
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up, tracking_entity=follow
    )
