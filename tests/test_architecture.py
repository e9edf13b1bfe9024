"""Imports run one way, and the pure part stays pure."""

from __future__ import annotations

import ast
import statistics
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

ROOMS = (
    {"ssmr.errors", "ssmr.types", "ssmr.parameters"},
    {"ssmr._jit", "ssmr.geometry", "ssmr.scenarios"},
    {"ssmr._trig", "ssmr.robot", "ssmr.search", "ssmr.metrics"},
    {"ssmr.models", "ssmr.estimation"},
    {"ssmr.simulation"},
    {"ssmr.control", "ssmr.lanes"},
    {"validation.thesis", "validation.store", "validation.reading", "validation.progress", "validation.words"},
    {"validation.logs", "validation.simulator"},
    {"validation.engines"},
    {"validation.plants"},
    {"validation.show"},
    {"validation.motion", "validation.cli"},
    {"validation.compare", "validation.recordings", "validation.robots"},
    {"validation.fit", "validation.track"},
    {"validation.tune", "validation.ros", "validation.learning"},
    {"validation.study", "validation.drive"},
    {"validation.replicate"},
)
"""The house, floor by floor: a room imports only from floors above its own line, and inside a room there is no cycle."""

BANNED_IN_SSMR = {
    "mujoco",
    "dm_control",
    "rerun",
    "matplotlib",
    "rich",
    "tyro",
    "validation",
    "os.path",
    "json",
    "tomllib",
    "time",
    "logging",
}
"""ssmr is numbers in, numbers out: no simulator, no viewer, no files, no clock."""


def modules() -> dict[str, Path]:
    found = {}
    for package in ("ssmr", "validation"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            if not name.endswith("__init__") and name != "validation.__main__":  # which is another name of one program
                found[name] = path
    return found


def imports(path: Path) -> set[str]:
    """Every imported module, wherever the import stands: also in functions and under TYPE_CHECKING."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def room_of(module: str) -> str:
    return ".".join(module.split(".")[:2])


def floor_of(module: str) -> int:
    return next(i for i, rooms in enumerate(ROOMS) if room_of(module) in rooms)


def room_imports() -> dict[str, set[str]]:
    """Every room with the rooms that its modules import."""
    paths = modules()
    found: dict[str, set[str]] = {room_of(name): set() for name in paths}
    for name, path in paths.items():
        found[room_of(name)] |= {room_of(other) for other in imports(path) & set(paths)} - {room_of(name)}
    return found


def test_every_module_has_its_room() -> None:
    assert {room_of(name) for name in modules()} == set().union(*ROOMS)


@pytest.mark.parametrize("name", sorted(modules()))
def test_imports_run_one_way(name: str) -> None:
    for other in imports(modules()[name]) & set(modules()):
        if room_of(other) != room_of(name):
            assert floor_of(other) < floor_of(name), f"{name} imports {other}"


def test_there_is_no_cycle() -> None:
    waiting = {name: imports(path) & set(modules()) - {name} for name, path in modules().items()}
    while ready := {name for name, wanted in waiting.items() if not wanted & set(waiting)}:
        waiting = {name: wanted for name, wanted in waiting.items() if name not in ready}
    assert not waiting, f"these import each other: {sorted(waiting)}"


@pytest.mark.parametrize("name", sorted(modules()))
def test_only_programs_know_the_command_line(name: str) -> None:
    used = imports(modules()[name])
    known = {"validation.cli", "tyro"} & {u for u in used}
    assert not known or name.endswith(".__main__") or room_of(name) == "validation.cli", f"{name} imports {sorted(known)}"


@pytest.mark.parametrize("name", sorted(n for n in modules() if n.startswith("ssmr")))
def test_ssmr_is_pure(name: str) -> None:
    used = imports(modules()[name])
    allowed = {"time", "logging"} if name == "ssmr._jit" else set()  # the age of the cache, and why there is none
    banned = {u for u in used if u in BANNED_IN_SSMR or u.split(".")[0] in BANNED_IN_SSMR} - allowed
    assert not banned, f"{name} imports {sorted(banned)}"


def test_only_the_compiler_cache_touches_files() -> None:
    for name, path in modules().items():
        if name.startswith("ssmr") and name != "ssmr._jit":
            assert not imports(path) & {"os", "pathlib", "tempfile", "shutil", "io"}, name


def test_no_module_needs_ros() -> None:
    """Everything of the nodes but the bytes is tested without DDS, which is imported by name when a node opens."""
    packages = {"cyclonedds", "rclpy", *(f"{kind}_msgs" for kind in ("geometry", "nav", "sensor"))}
    for name, path in modules().items():
        found = {u.split(".")[0] for u in imports(path)} & packages
        assert not found, f"{name} imports {sorted(found)}"


MOST_LINES, MOST_FUNCTION_LINES, MOST_PARAMETERS, MEDIAN_LINES = 450, 80, 8, 180
PROTOCOL = {
    "KIND": "the declaration of each plant that has a module of its own",
    "LAW": "the line of each planar model and of each controller in its table",
    "advance": "each planar model's step, and the function that chooses among them",
    "declare": "the declaration of a plant, in the module of each family of plants",
    "SCHEMA": "the kind and version of each document that is written",
    "T": "a type variable",
}
"""Public names that several modules share on purpose, and why."""
TO_BE_CUT = {"validation.compare.figure", "validation.compare.rerun"}
"""Modules that are still too long; none may join them."""
TO_BE_RENAMED = {
    *("AT_LIMIT", "Comparison", "METRICS", "STRETCH", "Series", "as_document"),
    *("grid", "headline", "markdown", "report_markdown", "side_by_side", "stacked"),
}
"""Public names that still mean several things; none may join them."""


def functions(path: Path) -> list[ast.FunctionDef]:
    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.FunctionDef)]


def test_modules_stay_short() -> None:
    lines = {name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in modules().items()}
    assert {name: n for name, n in lines.items() if n > MOST_LINES and name not in TO_BE_CUT} == {}
    assert statistics.median(lines.values()) <= MEDIAN_LINES


def test_functions_stay_short_and_take_few_parameters() -> None:
    for name, path in modules().items():
        for node in functions(path):
            a = node.args
            parameters = [p.arg for p in (*a.posonlyargs, *a.args, *a.kwonlyargs) if p.arg not in ("self", "cls")]
            assert len(parameters) <= MOST_PARAMETERS or name.endswith(".__main__"), (
                f"{name}.{node.name}: {len(parameters)} parameters"
            )
            length = (node.end_lineno or 0) - node.lineno + 1
            assert length <= MOST_FUNCTION_LINES, f"{name}.{node.name}: {length} lines"


def test_a_public_name_means_one_thing() -> None:
    """Command lines are left out: nobody imports them, and their functions are named after what they call."""
    homes: dict[str, set[str]] = {}
    for name, path in modules().items():
        if not name.endswith(".__main__"):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", node)]
                for target in targets:
                    known = getattr(target, "id", getattr(target, "name", "_"))
                    if isinstance(known, str) and not known.startswith("_"):
                        homes.setdefault(known, set()).add(name)
    shared = {known: sorted(places) for known, places in homes.items() if len(places) > 1}
    assert {known: places for known, places in shared.items() if known not in PROTOCOL and known not in TO_BE_RENAMED} == {}


def test_public_functions_say_what_they_do() -> None:
    for name, path in modules().items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                assert ast.get_docstring(node), f"{name}.{node.name}"
