"""Draw docs/img/architecture.svg: what flows, and through which package. `python docs/make_architecture_figure.py`."""

from __future__ import annotations

from html import escape
from pathlib import Path

OUT = Path(__file__).parent / "img" / "architecture.svg"
WIDTH, HEIGHT = 980, 560
INK, PURE, SHELL, FLOW = "#24292f", "#dbeaf7", "#fdebcf", "#0072b2"
Box = tuple[int, int, int, int]


def text(x: float, y: float, words: str, size: int = 14, *, bold: bool = False, anchor: str = "middle") -> str:
    """A line of text."""
    weight = ' font-weight="bold"' if bold else ""
    return f'<text x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="{anchor}" fill="{INK}"{weight}>{escape(words)}</text>'


def box(place: Box, title: str, *lines: str, fill: str = "#ffffff") -> str:
    """A box with a title and small print; `place` is x, y, width, height."""
    x, y, w, h = place
    top = y + h / 2 + 5 - 8.5 * len(lines)
    rows = [text(x + w / 2, top, title, bold=True)]
    rows += [text(x + w / 2, top + 17 * (i + 1), line, 12) for i, line in enumerate(lines)]
    return f'<rect x="{x}" y="{y}" width="{w}" height="{h}" rx="8" fill="{fill}" stroke="{INK}"/>' + "".join(rows)


def arrow(*points: tuple[int, int], dashed: bool = False) -> str:
    """An arrow along points."""
    path = " L".join(f"{x} {y}" for x, y in points)
    dashes = ' stroke-dasharray="6 4"' if dashed else ""
    return f'<path d="M{path}" fill="none" stroke="{FLOW}" stroke-width="2.2" marker-end="url(#head)"{dashes}/>'


def area(place: Box, fill: str, title: str, what: str) -> str:
    """A package."""
    x, y, w, h = place
    label = text(x + 14, y + 24, title, 16, bold=True, anchor="start")
    note = text(x + 14 + 10.5 * len(title) + 14, y + 24, what, 13, anchor="start")
    return f'<rect x="{x}" y="{y}" width="{w}" height="{h}" rx="12" fill="{fill}"/>' + label + note


def figure() -> str:
    """The whole drawing."""
    parts = [
        area((10, 10, 960, 128), SHELL, "validation", "the shell, upper part: files and names become values"),
        area((10, 152, 960, 238), PURE, "", ""),
        text(24, 336, "ssmr", 16, bold=True, anchor="start"),
        text(24, 357, "pure: numbers in, numbers out;", 13, anchor="start"),
        text(24, 375, "MuJoCo behind its protocol", 13, anchor="start"),
        area((10, 404, 960, 146), SHELL, "validation", "the shell, lower part: results, and sinks that return nothing"),
        box((40, 50, 210, 72), "SOURCE", "scenario traj1–4, CSV, bag"),
        box((290, 50, 210, 72), "profile (TOML)", "numbers of every plant"),
        box((700, 50, 240, 72), "search (jDE)", "ask: candidates, tell: costs"),
        box((40, 200, 170, 100), "Commands", "v, ω or wheel rates,", "held; N of them"),
        box((260, 200, 390, 170), ""),
        box((280, 226, 350, 36), "drive: delay, limits, wheel rates", fill="#f3f8fc"),
        box((280, 290, 168, 66), "planar models", "coulomb, improved,", "linear, kinematic", fill="#f3f8fc"),
        box((462, 290, 168, 66), "MuJoCo Husky", "models/husky.xml", fill="#f8d9a0"),
        box((700, 200, 240, 64), "Trajectory", "pose, twist, wheels: N + 1 rows"),
        box((700, 306, 240, 64), "metrics", "against the reference's trajectory"),
        box((700, 440, 240, 90), "Comparison, FitResult, …", "frozen, with versions and seed"),
        box((40, 440, 560, 90), "sinks", "table · picture (.png) · rerun recording (.rrd) · .json, .toml · pages"),
        arrow((125, 122), (125, 198)),
        arrow((395, 122), (395, 198)),
        arrow((210, 250), (258, 250)),
        arrow((364, 262), (364, 288)),
        arrow((546, 262), (546, 288)),
        arrow((650, 232), (698, 232)),
        arrow((820, 264), (820, 304)),
        arrow((820, 370), (820, 438)),
        arrow((700, 485), (602, 485)),
        arrow((940, 338), (957, 338), (957, 86), (942, 86), dashed=True),
        arrow((700, 86), (502, 86), dashed=True),
    ]
    plant = text(455, 219, "Plant: reset, step, run", bold=True)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="Helvetica, Arial, sans-serif">'
        '<defs><marker id="head" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0 L10 5 L0 10 z" fill="{FLOW}"/></marker></defs>'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>' + "\n".join(parts) + plant + "</svg>\n"
    )


if __name__ == "__main__":
    OUT.write_text(figure(), encoding="utf-8")
