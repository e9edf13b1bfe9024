"""Draw docs/img/architecture.svg from the imports: the rooms, and which imports which.

Run `python docs/make_architecture_figure.py`; tests/test_docs.py compares the picture with the
code.
"""

from __future__ import annotations

import sys
from collections import Counter
from html import escape
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.appendices import APPENDICES  # noqa: E402
from tests.test_architecture import room_imports  # noqa: E402

OUT = ROOT / "docs" / "img" / "architecture.svg"
WIDTH = 980
HEIGHT = 736
STEP = 62
BOX = 30
STRIP = 96
INK, FLOW = "#24292f", "#0072b2"
PANELS = {"validation": (10, 500, "#fdebcf"), "ssmr": (535, 435, "#dbeaf7")}
"""Left edge, width and colour of each package's panel."""
WORDS = {
    "validation": "validation: MuJoCo, files, pictures, command lines",
    "ssmr": "ssmr: numbers in, numbers out",
}
Graph = dict[str, set[str]]
Place = tuple[float, float]


def reached(graph: Graph, room: str) -> set[str]:
    """Return all rooms that a room imports, directly or through others."""
    return graph[room].union(*(reached(graph, other) for other in graph[room]))


def reduced(graph: Graph) -> Graph:
    """Return the graph without arrows that lead where others lead too."""
    return {
        room: {
            other
            for other in others
            if not any(other in reached(graph, via) for via in others - {other})
        }
        for room, others in graph.items()
    }


def heights(graph: Graph) -> dict[str, int]:
    """Return the floor of each room, from 0: directly above the highest room that it imports."""
    entries: dict[str, int] = {}

    def of(room: str) -> int:
        if room not in entries:
            entries[room] = 1 + max((of(other) for other in graph[room]), default=-1)
        return entries[room]

    return {room: of(room) for room in sorted(graph)}


def with_waypoints(graph: Graph, floor: dict[str, int]) -> list[list[str]]:
    """Return the links from floor to floor, each arrow as a chain.

    A long one passes each floor at a place of its own.
    """
    chains = []
    for room in sorted(graph):
        for other in sorted(graph[room]):
            between = [
                f"{room}>{other}>{level}" for level in range(floor[room] - 1, floor[other], -1)
            ]
            floor |= {name: int(name.rpartition(">")[2]) for name in between}
            chains.append([room, *between, other])
    return chains


def places(chains: list[list[str]], floor: dict[str, int], panel: str) -> dict[str, Place]:
    """Return where each room and each waypoint stands.

    Those of a floor in the order in which their neighbours stand.
    """
    near: dict[str, set[str]] = {name: set() for name in floor}
    for chain in chains:
        for one, other in pairwise(chain):
            near[one].add(other)
            near[other].add(one)
    x = dict.fromkeys(floor, 0.5)
    rows = [
        [name for name in floor if floor[name] == level] for level in range(1 + max(floor.values()))
    ]
    for _ in range(24):
        for row in rows:  # ties are broken by name, so that every run draws the same picture
            middle = {
                n: sum(sorted(x[o] for o in near[n])) / len(near[n]) if near[n] else 0.5
                for n in row
            }
            row.sort(key=lambda name: (round(middle[name], 9), name))
            for i, name in enumerate(row):
                x[name] = (i + 0.5) / len(row)
    left, width, _ = PANELS[panel]
    return {name: (left + width * x[name], HEIGHT - 44 - STEP * floor[name]) for name in floor}


def arrow(points: list[Place]) -> str:
    """Return an arrow from below one box, past waypoints, to the top of another box."""
    points = [
        (points[0][0], points[0][1] + BOX / 2),
        *points[1:-1],
        (points[-1][0], points[-1][1] - BOX / 2 - 2),
    ]
    path = f"M{points[0][0]:.0f} {points[0][1]:.0f}"
    for (x0, y0), (x1, y1) in pairwise(points):
        middle = 0.5 * (y0 + y1)
        path += f" C{x0:.0f} {middle:.0f} {x1:.0f} {middle:.0f} {x1:.0f} {y1:.0f}"
    return (
        f'<path d="{path}" fill="none" stroke="{FLOW}" stroke-width="1.5" marker-end="url(#head)"/>'
    )


def box(room: str, centre: Place, width: float) -> str:
    """Return a room's box with its name."""
    x, y = centre
    name = escape(room.split(".")[1])
    size = 11 if width < 80.0 else 13
    return (
        f'<rect x="{x - width / 2:.0f}" y="{y - BOX / 2:.0f}" width="{width:.0f}" height="{BOX}" '
        f'rx="7" fill="#ffffff" stroke="{INK}"/>'
        f'<text x="{x:.0f}" y="{y + 5:.0f}" font-size="{size}" text-anchor="middle" '
        f'fill="{INK}">{name}</text>'
    )


def top_of(floor: dict[str, int]) -> float:
    """Return the upper edge of a panel with these floors."""
    return HEIGHT - 44 - STEP * max(floor.values()) - 62


def panel(package: str, graph: Graph) -> list[str]:
    """Return a package's panel: its rooms and the arrows between them."""
    left, width, fill = PANELS[package]
    mine = reduced(
        {
            room: {o for o in others if o.startswith(package)}
            for room, others in graph.items()
            if room.startswith(package)
        }
    )
    floor = heights(mine)
    # what stands at the bottom serves everybody: only arrows from the next floor are drawn
    near = {
        room: {other for other in others if floor[other] or floor[room] == 1}
        for room, others in mine.items()
    }
    chains = with_waypoints(near, floor)
    at = places(chains, floor, package)
    wide = min(104.0, width / max(Counter(floor.values()).values()) - 6.0)
    top = top_of(floor)
    height = HEIGHT - 10 - top
    frame = (
        f'<rect x="{left}" y="{top:.0f}" width="{width}" height="{height:.0f}" rx="12" '
        f'fill="{fill}"/>'
    )
    title = (
        f'<text x="{left + 14}" y="{top + 25:.0f}" font-size="14" fill="{INK}">'
        f"{escape(WORDS[package])}</text>"
    )
    return [
        frame,
        title,
        *(arrow([at[n] for n in chain]) for chain in chains),
        *(box(room, at[room], wide) for room in sorted(mine)),
    ]


def appendices(top: float) -> list[str]:
    """Return the panel of the appendices, which stands above the core: no room imports one."""
    left, width, _ = PANELS["validation"]
    bottom = top + STRIP
    step = width / len(APPENDICES)
    at = {name: (left + step * (k + 0.5), top + 62.0) for k, name in enumerate(APPENDICES)}
    middle = left + width / 2
    return [
        f'<rect x="{left}" y="{top:.0f}" width="{width}" height="{STRIP}" rx="12" fill="#eeeeee"/>',
        f'<text x="{left + 14}" y="{top + 25:.0f}" font-size="14" fill="{INK}">'
        "appendices: no other room imports one, each can be deleted</text>",
        *(box(f"validation.{name}", place, step - 8.0) for name, place in at.items()),
        f'<path d="M{middle:.0f} {bottom:.0f} v24" stroke="{FLOW}" stroke-width="4" '
        'marker-end="url(#head)"/>',
    ]


def figure() -> str:
    """Return the whole drawing."""
    graph = {
        room: others
        for room, others in room_imports().items()
        if room.partition(".")[2] not in APPENDICES
    }
    core = {
        room: {other for other in others if other.startswith("validation")}
        for room, others in graph.items()
        if room.startswith("validation")
    }
    above = top_of(heights(core)) - 26 - STRIP
    edge = above - 10
    tall = HEIGHT - edge
    x = PANELS["validation"][0] + PANELS["validation"][1]
    end = PANELS["ssmr"][0] - 3
    across = (
        f'<path d="M{x} {HEIGHT / 2:.0f} L{end} {HEIGHT / 2:.0f}" stroke="{FLOW}" '
        'stroke-width="4" marker-end="url(#head)"/>'
    )
    parts = [*panel("validation", graph), *panel("ssmr", graph), *appendices(above), across]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 {edge:.0f} {WIDTH} {tall:.0f}" '
        'font-family="Helvetica, Arial, sans-serif">'
        '<defs><marker id="head" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="7" '
        'markerHeight="7" orient="auto" '
        f'markerUnits="userSpaceOnUse"><path d="M0 0 L10 5 L0 10 z" fill="{FLOW}"/></marker></defs>'
        f'<rect y="{edge:.0f}" width="{WIDTH}" height="{tall:.0f}" '
        'fill="#ffffff"/>\n' + "\n".join(parts) + "</svg>\n"
    )


if __name__ == "__main__":
    OUT.write_text(figure(), encoding="utf-8")
