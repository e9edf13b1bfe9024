"""The documentation agrees with the code: parameters, modules, links, tests of errata."""

from __future__ import annotations

import ast
import importlib
import math
import re
import runpy
import subprocess
import sys
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest

from ssmr.control.laws import LAWS
from ssmr.estimation.settings import EkfSettings
from ssmr.models.four_wheel import FourWheelParameters
from ssmr.models.law import PLANAR_MODELS, planar_law
from ssmr.robot.sensors import SensorModel, SensorNoise
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.scenarios import SineScenario
from tests.appendices import is_deleted
from tests.test_architecture import modules, room_of
from validation.descriptions.importing import unit_of_key
from validation.simulator.calibration import Calibration
from validation.simulator.description import SECTIONS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [
    *sorted(DOCS.glob("*.md")),
    *sorted(ROOT.glob("*.md")),
]
DOCUMENTED = (
    Vehicle,
    Drive,
    *(planar_law(name).parameters for name in PLANAR_MODELS),
    FourWheelParameters,
    Calibration,
    SineScenario,
    SensorNoise,
    EkfSettings,
    SensorModel,
    *(law.gains for law in LAWS.values()),
)
GRADES = {"hardware", "maker", "stated", "published", "derived", "assumed", "fitted"}


def tables(page: str) -> dict[str, list[list[str]]]:
    """Rows of all tables of a page by the heading they stand under.

    Header rows and rulers left out.
    """
    entries: dict[str, list[list[str]]] = {}
    heading = ""
    header = True
    for line in (DOCS / page).read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ").strip("`")
        if not line.startswith("|"):
            header = True
        elif header:
            header = False
        elif not line.startswith("|---"):
            entries.setdefault(heading, []).append(
                [cell.strip() for cell in line.strip("|").split("|")]
            )
    return entries


def matches(written: str, value: object) -> bool:
    """Whether a cell writes this value."""
    if isinstance(value, str):
        return written == value
    return (
        isinstance(value, int | float) and (math.inf if written == "∞" else float(written)) == value
    )


@pytest.mark.parametrize("kind", DOCUMENTED, ids=lambda kind: kind.__name__)
def test_every_parameter_is_listed_with_its_default(kind: Any) -> None:
    rows = {row[0].strip("`"): row for row in tables("equations.md")[kind.__name__]}
    assert list(rows) == [f.name for f in fields(kind)]
    for f in fields(kind):
        if f.default is MISSING:
            assert rows[f.name][1] == "–", f.name
        else:
            assert matches(rows[f.name][1], f.default), (f.name, rows[f.name][1], f.default)


def test_every_parameter_has_a_unit_and_a_known_grade() -> None:
    parameters = {*(kind.__name__ for kind in DOCUMENTED), "Constants"}
    assert parameters <= set(tables("equations.md"))
    for heading in parameters:
        for row in tables("equations.md")[heading]:
            unit = row[-3]
            grade = row[-2]
            assert unit, (heading, row)
            assert grade in GRADES, (heading, row)


def test_every_key_of_a_robot_s_file_is_listed() -> None:
    rows = {row[0].strip("`"): row for row in tables("robots.md")["The file"]}
    keys = {}
    for section in ("geometry", "mass", "simulation"):
        keys |= {f"{section}.{key}": f for key, f in SECTIONS[section].items()}
    assert list(rows) == list(keys)
    for key, f in keys.items():
        _, unit, usual, _ = rows[key]
        assert unit == (unit_of_key(key).replace("m2", "m²") or "–"), key
        assert (usual == "must be given") == (f.default is MISSING), key
        if usual[0].isdigit() or usual.startswith("`"):
            assert matches(usual.strip("`"), f.default), key


def constant(room: str, name: str) -> object:
    """The value of a constant in any module of a room, with or without a leading underscore."""
    path = ROOT.joinpath(*room.split("."))
    inside = [
        f"{room}.{p.stem}" for p in sorted(path.glob("*.py")) if not p.stem.startswith("__")
    ] or [room]
    scopes = [vars(importlib.import_module(module)) for module in inside]
    (value,) = {scope.get(name, scope.get(f"_{name}")) for scope in scopes} - {None}
    return value


def test_constants_are_listed_as_they_are() -> None:
    for name, written, *_ in tables("equations.md")["Constants"]:
        room, _, attribute = name.strip("`").rpartition(".")
        assert matches(written, constant(room, attribute)), name


def without_code(text: str) -> str:
    """A page without its code: links and headings in it are none."""
    return re.sub(r"^```.*?^```$|`[^`\n]*`", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as on GitHub: letters, digits, a hyphen for every blank."""
    entries: set[str] = set()
    text = re.sub(
        r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    for heading in re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE):
        slug = re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")
        copies = sum(
            name == slug or re.fullmatch(re.escape(slug) + r"-\d+", name) is not None
            for name in entries
        )
        entries.add(f"{slug}-{copies}" if copies else slug)
    return entries


def links(page: Path) -> list[tuple[str, str]]:
    """Relative links of a page: file, empty for the page itself, and heading, empty for none."""
    targets = re.findall(r"\]\(([^)\s]+)[^)]*\)", without_code(page.read_text(encoding="utf-8")))
    local = [
        target for target in targets if "://" not in target and not target.startswith("mailto:")
    ]
    return [(file, heading) for file, _, heading in (target.partition("#") for target in local)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_somewhere(page: Path) -> None:
    for file, heading in links(page):
        target = page.parent / file if file else page
        assert target.exists() or is_deleted(target), file
        if heading and target.exists():
            assert heading in anchors(target), (
                f"{file}#{heading}: there are {sorted(anchors(target))}"
            )


def test_addresses_of_earlier_versions_lead_somewhere() -> None:
    tree = ast.parse((DOCS / "conf.py").read_text(encoding="utf-8"))
    (moved,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MOVED"
    )
    for old, new in moved.items():
        assert not (DOCS / f"{old}.md").exists()
        page, _, heading = new.partition(".html")
        assert not heading or heading[1:] in anchors(DOCS / f"{page}.md"), new


def test_every_page_is_listed_in_the_index() -> None:
    listed = {file for file, _ in links(DOCS / "index.md")}
    assert {page.name for page in PAGES if page.parent == DOCS} - {"index.md"} <= listed


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    for needed in ("sphinx", "myst_parser", "furo", "latex2mathml"):
        pytest.importorskip(needed, reason="the extra `docs` is not installed")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-b",
        "html",
        str(DOCS),
        str(tmp_path / "site"),
    ]
    built = subprocess.run(
        [*command, "-d", str(tmp_path / "trees")], capture_output=True, text=True, timeout=300
    )
    assert built.returncode == 0, built.stderr
    equations = (tmp_path / "site" / "equations.html").read_text(encoding="utf-8")
    assert equations.count('display="block"') == (DOCS / "equations.md").read_text(
        encoding="utf-8"
    ).count("```math")
    for page in (tmp_path / "site").glob("*.html"):  # it works without a network
        commanded = re.findall(
            r"<(?:script|link|img)[^>]+(?:src|href)=\"(?:https?:)?//[^\"]+",
            page.read_text(encoding="utf-8"),
        )
        assert not commanded, page


def test_the_picture_of_the_rooms_is_what_the_imports_say() -> None:
    """`python docs/make_architecture_figure.py` draws it anew."""
    draw = runpy.run_path(str(DOCS / "make_architecture_figure.py"))
    assert (DOCS / "img" / "architecture.svg").read_text(encoding="utf-8") == draw["figure"]()


def test_every_room_has_a_paragraph() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\w+", " ".join(re.findall(r"\*\*([\w, ]+?)\.?\*\*", text))))
    assert {room_of(name).partition(".")[2] for name in modules()} <= named
