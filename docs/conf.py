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


def prepare(app: Sphinx, name: str, source: list[str]) -> None:
    """Let links to README, which is no page of the site, lead to its first page.

    Give the index its navigation, and the page on security its text, which lies beside README.
    """
    source[0] = source[0].replace("](../README.md", "](index.md")
    if name == "reliability":
        page = Path(app.srcdir).with_name("SECURITY.md")
        source[0] = page.read_text(encoding="utf-8").replace("](docs/", "](")
    if name == "index":
        source[0] += navigation(source[0], {path.stem for path in Path(app.srcdir).glob("*.md")})


def setup(app: Sphinx) -> None:
    """Equations become MathML while the site is built.

    Browsers draw it without a script, so the site works offline.
    """
    app.add_html_math_renderer("mathml", (write_inline, None), (write_block, None))
    app.connect("source-read", prepare)
    # new pages change its navigation
    app.connect("env-get-outdated", lambda app, env, added, changed, removed: ["index"])
