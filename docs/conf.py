"""The site of these pages: `python -m sphinx -W -b html docs docs/_build`.

GitHub shows the same pages as they are. Only index.md lists the pages: each of its headings with
pages becomes a group of the site's navigation.
"""

from __future__ import annotations

import re
from importlib.metadata import version as installed
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.writers.html5 import HTML5Translator

project = "ssmr-testbed"
author = "the authors of ssmr-testbed"
release = version = installed("ssmr-testbed")

extensions = ["myst_parser", "sphinx_copybutton"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # GitHub's way to write a displayed equation
myst_heading_anchors = 4  # links to headings as GitHub makes them

html_theme = "furo"
html_show_copyright = html_show_sphinx = False
html_title = "Skid-steering robots, simulated and real"
html_math_renderer = "mathml"
html_static_path = ["site.css"]
html_css_files = ["site.css"]


def mathml(latex: str, display: str) -> str:
    """Return an equation as MathML.

    Raises:
        ExtensionError: the converter did not understand a part of it, which it then leaves
            unchanged.
    """
    made = convert(latex.replace("{aligned}", "{align*}"), display=display)
    if "\\" in made or ">&<" in made:
        raise ExtensionError(f"an equation cannot be written as MathML: {latex}")
    return made


def write_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write an equation in a sentence."""
    translator.body.append(mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def write_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write an equation on a line of its own."""
    translator.body.append(f'<div class="equation">{mathml(node.astext(), "block")}</div>')
    raise nodes.SkipNode


def navigation(index: str, pages: set[str]) -> str:
    """Return the site's tables of contents: for each section of the index its pages.

    The rest as `More`.
    """
    out = []
    left = pages - {"index"}
    for section in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        listed = [
            page for page in dict.fromkeys(re.findall(r"\]\((\w+)\.md\)", section)) if page in left
        ]
        left -= set(listed)
        out.append((section.splitlines()[0], listed))
    out.append(("More", sorted(left)))
    return "".join(
        "\n```{toctree}\n:hidden:\n:caption: " + caption + "\n\n" + "\n".join(listed) + "\n```\n"
        for caption, listed in out
        if listed
    )


MOVED = {
    "cases": "why_drift.html#cases-for-any-simulator",
    "centre_of_mass": "lab.html#centre-of-mass",
    "clusters": "identification.html#workers-on-other-machines",
    "filter": "tracking.html#the-state-filter",
    "gallery": "first_comparison.html#examples",
    "parameters": "equations.html#parameters",
    "printed_parameters": "lab.html#the-printed-parameters-in-mujoco",
    "references": "tracking.html#reference-trajectories",
    "reliability": "index.html",
    "runs": "tile.html#every-log-calibrated-and-judged-on-what-it-has-not-seen",
    "speed": "index.html",
    "wet_grass": "tile.html#tile-and-wet-grass",
}
"""Pages of earlier versions, and where their contents stand now."""


def lead_on(app: Sphinx, error: Exception | None) -> None:
    """Write a page that leads on for each address of an earlier version."""
    for old, new in MOVED.items() if error is None else ():
        head = f'<meta http-equiv="refresh" content="0; url={new}">'
        page = f'<!doctype html><title>Moved</title>{head}<a href="{new}">This page moved.</a>'
        Path(app.outdir, f"{old}.html").write_text(page, encoding="utf-8")


def prepare(app: Sphinx, name: str, source: list[str]) -> None:
    """Let links to README, which is no page of the site, lead to its first page.

    Links to other files beside README become their names. Give the index its navigation.
    """
    source[0] = source[0].replace("](../README.md", "](index.md")
    source[0] = re.sub(r"\[([^\]]*)\]\(\.\./(\w+\.md)(#[\w-]*)?\)", r"\1 (`\2`)", source[0])
    if name == "index":
        source[0] += navigation(source[0], {path.stem for path in Path(app.srcdir).glob("*.md")})


def setup(app: Sphinx) -> None:
    """Equations become MathML while the site is built.

    Browsers draw it without a script, so the site works offline.
    """
    app.add_html_math_renderer("mathml", (write_inline, None), (write_block, None))
    app.connect("source-read", prepare)
    app.connect("build-finished", lead_on)
    # new pages change its navigation
    app.connect("env-get-outdated", lambda app, env, added, changed, removed: ["index"])
