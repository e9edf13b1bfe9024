"""Imports run one way, the pure part stays pure, and no room costs more than it is worth."""

from __future__ import annotations

import ast
import statistics
from collections import Counter
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.appendices import gone_rooms

ROOT = Path(__file__).resolve().parents[1]

ROOMS = (
    {"ssmr.errors"},
    {"ssmr.types", "ssmr.parameters"},
    {"ssmr._jit", "ssmr.geometry", "ssmr.scenarios"},
    {"ssmr.robot", "ssmr.search", "ssmr.metrics"},
    {"ssmr.models", "ssmr.estimation"},
    {"ssmr.simulation"},
    {"ssmr.control", "ssmr.lanes"},
    {
        "validation.interrupts",
        "validation.output",
    },
    {"validation.workers"},
    {"validation.files"},
    {"validation.simulator"},
    {"validation.descriptions"},
    {"validation.engines"},
    {"validation.plants"},
    {"validation.experiment"},
    {"validation.report"},
    {"validation.cli"},
    {"validation.identify"},
    {
        "validation.compare",
        "validation.recordings",
        "validation.robots",
        "validation.sweep",
        "validation.table",
    },
    {"validation.fit", "validation.track"},
    {"validation.refitting"},
    {"validation.tune", "validation.calibrate", "validation.ros", "validation.learning"},
    {"validation.study"},
    {"validation.replicate"},
)
"""The house, floor by floor: a room imports only from floors above its own line, and inside a room
there is no cycle."""

BANNED_IN_SSMR = {
    *("mujoco", "dm_control", "rerun", "matplotlib", "rich", "tyro", "validation"),
    *("os.path", "json", "tomllib", "time", "logging"),
}
"""ssmr is numbers in, numbers out: no simulator, no viewer, no files, no clock."""


@cache
def modules() -> dict[str, Path]:
    paths = {}
    for package in ("ssmr", "validation"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            # which is another name of one program
            if not name.endswith("__init__") and name != "validation.__main__":
                paths[name] = path
    return paths


@cache
def tree(name: str) -> ast.Module:
    return ast.parse(modules()[name].read_text(encoding="utf-8"))


@cache
def imports(name: str) -> frozenset[str]:
    """Every imported module, also of imports in functions and under TYPE_CHECKING."""
    names = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import"
            names.add(node.module or "")
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def room_of(module: str) -> str:
    return ".".join(module.split(".")[:2])


def floor_of(module: str) -> int:
    return next(i for i, rooms in enumerate(ROOMS) if room_of(module) in rooms)


def room_imports() -> dict[str, set[str]]:
    """Every room with the rooms that its modules import, for the picture of the architecture."""
    drawn: dict[str, set[str]] = {room_of(name): set() for name in modules()}
    for name in modules():
        drawn[room_of(name)] |= {room_of(other) for other in imports(name) & set(modules())} - {
            room_of(name)
        }
    return drawn


def test_every_module_has_its_room() -> None:
    gone = {room.replace("/", ".") for room in gone_rooms()}
    assert {room_of(name) for name in modules()} == set().union(*ROOMS) - gone


def test_what_is_imported_is_there() -> None:
    """The type checker takes a module of ours that is missing for a foreign one without types."""
    packages = {".".join(path.parent.relative_to(ROOT).parts) for path in modules().values()}
    for name in modules():
        for node in ast.walk(tree(name)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in (
                "ssmr",
                "validation",
            ):
                assert node.module in modules() or node.module in packages, (
                    f"{name} imports {node.module}"
                )


def test_imports_run_one_way() -> None:
    for name in modules():
        for other in imports(name) & set(modules()):
            assert room_of(other) == room_of(name) or floor_of(other) < floor_of(name), (
                f"{name} imports {other}"
            )


def test_there_is_no_cycle() -> None:
    waiting = {name: imports(name) & set(modules()) - {name} for name in modules()}
    while ready := {name for name, wanted in waiting.items() if not wanted & set(waiting)}:
        waiting = {name: wanted for name, wanted in waiting.items() if name not in ready}
    assert not waiting, f"these import each other: {sorted(waiting)}"


def test_only_programs_know_the_command_line() -> None:
    for name in modules():
        known = {"validation.cli", "tyro"} & imports(name)
        is_program = (
            name.endswith((".__main__", ".replicate.run", ".identify.search"))
            or name.count(".") == 1
            or room_of(name) in ("validation.study", "validation.ros")
        )
        assert not known or is_program or room_of(name) == "validation.cli", (
            f"{name} imports {sorted(known)}"
        )


def test_ssmr_is_pure() -> None:
    for name in (n for n in modules() if n.startswith("ssmr")):
        # the age of the cache, and why there is none
        allowed = {"time", "logging"} if name == "ssmr._jit" else set()
        banned = {
            u for u in imports(name) if u in BANNED_IN_SSMR or u.split(".")[0] in BANNED_IN_SSMR
        } - allowed
        assert not banned, f"{name} imports {sorted(banned)}"
        if name != "ssmr._jit":  # the compiler's cache
            assert not imports(name) & {"os", "pathlib", "tempfile", "shutil", "io"}, name


def test_no_module_needs_ros() -> None:
    """DDS is imported by name, when a port opens."""
    for name in modules():
        assert not {u.split(".")[0] for u in imports(name)} & {"rospy", "rclpy", "cyclonedds"}, name


def test_no_signal_is_named_that_windows_lacks() -> None:
    for name in modules():
        named = {node.attr for node in ast.walk(tree(name)) if isinstance(node, ast.Attribute)}
        named = {known for known in named if known.startswith("SIG")}
        assert named <= {"SIGINT", "SIGTERM", "SIG_DFL", "SIG_IGN"}, name


OWN_DOORS = {
    "ssmr._jit": "sources of this package",
    "validation.files.reading": "the door: a regular file, of a limited size",
    "validation.files.csv_logs": "a log that is written beside its place",
    "validation.output": "files that are written",
    "validation.replicate.chapters": "templates of this package",
    "validation.replicate.published": "tables of this package",
    "validation.replicate.verdicts": "tables of this package",
    "validation.study.runs": "its own results",
}
"""Modules that open files otherwise than by `validation.files.reading`, and which these are."""


def is_door(node: ast.AST) -> bool:
    """Whether a node opens a file by a path: a pipe of that name would be waited for."""
    if not isinstance(node, ast.Call):
        return False
    if isinstance(node.func, ast.Name):
        return node.func.id == "open"
    if not isinstance(node.func, ast.Attribute):
        return False
    through_reading = ast.unparse(node.func.value) in ("reading", "os", "zipfile")
    return node.func.attr in ("open", "read_text", "read_bytes") and not through_reading


def test_files_of_others_have_one_door() -> None:
    for name in modules():
        if name not in OWN_DOORS:
            doors = [node for node in ast.walk(tree(name)) if is_door(node)]
            assert not doors, f"{name}, line {getattr(doors[0], 'lineno', 0)}"


MOST_LINES = 600
MOST_FUNCTION_LINES = 80
MOST_PARAMETERS = 8
MEDIAN_LINES = 250
PROTOCOL = {
    "PROGRAM": "the commands of a program that has several",
    "LAW": "the line of each planar model and of each controller in its table",
    "advance": "each planar model's step, and the function that chooses among them",
    "declare": "the declaration of a plant, in the module of each family of plants, and of columns",
    "SCHEMA": "the kind and version of each document that is written",
    "T": "a type variable",
}
"""Public names that several modules share on purpose, and why."""


def functions(name: str) -> list[ast.FunctionDef]:
    return [node for node in ast.walk(tree(name)) if isinstance(node, ast.FunctionDef)]


def test_modules_stay_short() -> None:
    lines = {
        name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in modules().items()
    }
    assert {name: n for name, n in lines.items() if n > MOST_LINES} == {}
    assert statistics.median(lines.values()) <= MEDIAN_LINES


def test_functions_stay_short_and_take_few_parameters() -> None:
    for name in modules():
        for node in functions(name):
            a = node.args
            parameters = [
                p.arg
                for p in (*a.posonlyargs, *a.args, *a.kwonlyargs)
                if p.arg not in ("self", "cls")
            ]
            assert len(parameters) <= MOST_PARAMETERS or name.endswith(".__main__"), (
                f"{name}.{node.name}: {len(parameters)} parameters"
            )
            length = (node.end_lineno or 0) - node.lineno + 1
            assert length <= MOST_FUNCTION_LINES, f"{name}.{node.name}: {length} lines"


MOST_NODES_OF_A_STATEMENT = 12.0
MOST_TUPLES_OF_1000_LINES = 3.0
MOST_DOUBLE_LOOPS = 15
MOST_POSITIONAL = 6
MOST_SKIPS = 5
LISTS_OF_ANY_LENGTH = ("max", "min", "print")
COMPREHENSIONS = (ast.ListComp, ast.GeneratorExp, ast.DictComp, ast.SetComp)


@cache
def product() -> dict[Path, ast.Module]:
    """The syntax tree of each file of the product."""
    rooms = ("ssmr", "validation", "benchmarks")
    paths = [path for room in rooms for path in files_of(room)]
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def nodes_of_statement(statement: ast.stmt) -> int:
    """Nodes of a statement without those of the statements inside it."""
    count = 0
    waiting: list[ast.AST] = [statement]
    while waiting:
        node = waiting.pop()
        count += 1
        waiting += [n for n in ast.iter_child_nodes(node) if not isinstance(n, ast.stmt)]
    return count


def is_tuple_assignment(node: ast.AST) -> bool:
    """Whether a node is `a, b = x, y`."""
    return (
        isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
    )


def is_nested_conditional(node: ast.AST) -> bool:
    """Whether a node is a conditional expression that contains another one."""
    if not isinstance(node, ast.IfExp):
        return False
    return sum(isinstance(inner, ast.IfExp) for inner in ast.walk(node)) > 1


def is_double_loop(node: ast.AST) -> bool:
    """Whether a node is a comprehension with two loops."""
    return isinstance(node, COMPREHENSIONS) and len(node.generators) > 1


def has_many_positional(node: ast.AST) -> bool:
    """Whether a node is a call whose arguments are too many to be told apart by their place."""
    if not isinstance(node, ast.Call) or len(node.args) <= MOST_POSITIONAL:
        return False
    if any(isinstance(argument, ast.Starred) for argument in node.args):
        return False
    return ast.unparse(node.func) not in LISTS_OF_ANY_LENGTH


def places_of(applies: Callable[[ast.AST], bool]) -> list[str]:
    """File and line of each node of the product to which a rule applies."""
    places = []
    for path, parsed in product().items():
        name = path.relative_to(ROOT)
        for node in ast.walk(parsed):
            if applies(node):
                places.append(f"{name}:{getattr(node, 'lineno', 0)}")
    return places


def test_a_statement_holds_one_thought() -> None:
    nodes = 0
    statements = []
    for path, parsed in product().items():
        for node in ast.walk(parsed):
            nodes += 1
            if isinstance(node, ast.stmt):
                statements.append((path, node))
    mean = nodes / len(statements)
    worst = ""
    if mean > MOST_NODES_OF_A_STATEMENT:
        counted = [(nodes_of_statement(node), path, node.lineno) for path, node in statements]
        worst = ", ".join(
            f"{path.relative_to(ROOT)}:{line} ({size})"
            for size, path, line in sorted(counted)[:-11:-1]
        )
    assert mean <= MOST_NODES_OF_A_STATEMENT, (
        f"a statement has {mean:.2f} nodes on average, and may have "
        f"{MOST_NODES_OF_A_STATEMENT:g}; the heaviest: {worst}"
    )


def test_values_are_assigned_one_by_one() -> None:
    places = places_of(is_tuple_assignment)
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in product())
    most = MOST_TUPLES_OF_1000_LINES * lines / 1000.0
    crowded = Counter(place.partition(":")[0] for place in places).most_common(5)
    assert len(places) <= most, (
        f"{len(places)} assignments of tuples to tuples, of at most {most:.0f}; the most: {crowded}"
    )


def test_no_conditional_is_nested() -> None:
    places = places_of(is_nested_conditional)
    assert not places, f"conditional expressions inside others: {', '.join(places)}"


def test_comprehensions_have_one_loop() -> None:
    places = places_of(is_double_loop)
    assert len(places) <= MOST_DOUBLE_LOOPS, (
        f"{len(places)} comprehensions of two loops, of at most {MOST_DOUBLE_LOOPS}: "
        f"{', '.join(places)}"
    )


def test_arguments_have_names() -> None:
    places = places_of(has_many_positional)
    assert not places, f"more than {MOST_POSITIONAL} positional arguments: {', '.join(places)}"


def test_the_formatter_lays_out_all_but_tables() -> None:
    places = []
    for path in product():
        rows = path.read_text(encoding="utf-8").splitlines()
        for number, row in enumerate(rows, start=1):
            if "fmt: skip" in row or "fmt: off" in row:
                places.append(f"{path.relative_to(ROOT)}:{number}")
    assert len(places) <= MOST_SKIPS, (
        f"{len(places)} places that the formatter skips, of at most {MOST_SKIPS}: "
        f"{', '.join(places)}"
    )


def test_a_public_name_means_one_thing() -> None:
    """Command lines are left out.

    Nobody imports them, and their functions are named after what they call.
    """
    homes: dict[str, set[str]] = {}
    for name in modules():
        if not name.endswith(".__main__"):
            for node in tree(name).body:
                targets = (
                    node.targets
                    if isinstance(node, ast.Assign)
                    else [getattr(node, "target", node)]
                )
                for target in targets:
                    known = getattr(target, "id", getattr(target, "name", "_"))
                    if isinstance(known, str) and not known.startswith("_"):
                        homes.setdefault(known, set()).add(name)
    shared = {known: sorted(places) for known, places in homes.items() if len(places) > 1}
    assert {known: places for known, places in shared.items() if known not in PROTOCOL} == {}


def test_public_functions_say_what_they_do() -> None:
    for name in modules():
        for node in tree(name).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                assert ast.get_docstring(node), f"{name}.{node.name}"


class Price(NamedTuple):
    """The most that a room may cost a reader, with a twentieth of air, and the gain of users."""

    nodes: int
    """Nodes of the syntax trees, of every kind that `ast.walk` visits."""
    types: int
    """Value types: dataclasses and named tuples."""
    names: int
    """Public functions and classes of the modules."""
    gain: str


PRICES = {
    "ssmr": Price(
        72_100,
        66,
        266,
        "models, friction laws, controllers, estimation, metrics, jDE: what all results rest on; "
        "a plan that keeps to its path where time is uncertain; paths that are driven backwards "
        "and turn on the spot, each refused to the laws that cannot follow it",
    ),
    "validation/cli": Price(
        7_000,
        3,
        26,
        "how texts of options are read and options checked, with annotations for all that is "
        "accepted; exit status, progress; "
        "a run is repeated by its file, and its picture written for a paper; help and completion "
        "have each text in one line and no default that says nothing; tyro has the rest",
    ),
    "validation/engines": Price(
        9_000,
        3,
        14,
        "second opinions by ODE and Drake, also on the contacts of a description by others",
    ),
    "validation/identify": Price(
        36_280,
        14,
        97,
        "what finds a plant's parameters and a controller's gains, with their uncertainty, also of "
        "several logs: one body, a localiser for each, and how much days differ; all of a log is "
        "fitted, its thirds in motion judge, and better is more than chance; "
        "a watch on tyres; "
        "searches that drive a body once however it is seen, and guess derivatives on the way; "
        "the better judge of turns; "
        "friction: torques from a simulation or a log's currents; a robot's driver and inertia",
    ),
    "validation/learning": Price(
        6_700,
        3,
        11,
        "reinforcement learning on the robot: Gymnasium, also many as one batch, and dm_control",
    ),
    "validation/descriptions": Price(
        37_200,
        8,
        40,
        "robots of others are read (URDF, xacro, SDF, MJCF), driven with their own physics, and "
        "what is wrong is said with changes that were tried: whatever stops, slows or turns them "
        "is weighed against what a turn needs; each is a plant by its path",
    ),
    "validation/files": Price(
        57_850,
        30,
        119,
        "any log, a frame of pandas too, is read as one form, of tables in any usual layout, with "
        "names and units of others, and of bags on one clock with the most independent pose and "
        "the efforts of joints; one model explains it, and of hypotheses that compete the best is "
        "named, for all of it or from when to when; it is told part by part, and written",
    ),
    "validation/plants": Price(
        7_465,
        5,
        33,
        "every plant declared once, with the numbers that its robot lets a fit move, and profiles",
    ),
    "validation/replicate": Price(
        12_790,
        9,
        39,
        "the thesis beside us, row by row",
    ),
    "validation/report": Price(
        24_560,
        11,
        52,
        "tables, pictures and rerun recordings of all programs",
    ),
    "validation/ros": Price(
        17_700,
        5,
        37,
        "the robot and its controller on a ROS 2 graph, also along paths in a frame, of "
        "files or nav_msgs/Path, backwards where their poses say so, wherever /tf "
        "says that the odometry is; a supervisor names what is wrong with it, another "
        "driver by odometry alone, and a robot that was held waits for a confirmation and "
        "goes on from its pose",
    ),
    "validation/simulator": Price(
        22_530,
        5,
        67,
        "a robot's description becomes a MuJoCo model that moves, and files of other programs, "
        "also nav2's limits and dead times",
    ),
    "validation/study": Price(
        8_980,
        7,
        26,
        "answers: contact of a robot with its weight in the middle, transfer, drive train",
    ),
    "validation/experiment": Price(
        15_600,
        9,
        54,
        "scenarios and logs that plants are driven along, their runs and scores (what comparison, "
        "fit and pictures each had), those of hours part by part; references, gains, controllers "
        "in loops",
    ),
    "validation/.": Price(
        28_950,
        18,
        59,
        "results side by side, drawn too, comparison, fit, calibration with its verdict, tuning, "
        "robots, what a log contains and can tell, and its conversion, whole writing; workers",
    ),
    "benchmarks": Price(
        3_600,
        0,
        11,
        "speed beside other libraries, and what starts of programs take beside their imports",
    ),
}
"""The price of each room. A feature buys its room: what needs more takes it from something else in
the same commit, or the table changes with a sentence on what users get for it. Lines are not
counted, so that plain layout costs nothing."""
OPTIONS = {"compare": 30, "fit": 38, "calibrate": 17, "track": 27, "tune": 29}
"""Options of each program's command line, its positional arguments among them.

Each has `plain` for its picture, those that film robots have `no_picture`, and those that read logs
four that say how. A fit has two for torques: their weight, and the constant that makes them of
currents; one says what wheel rates are.
"""
MOST_FILES = 226
MOST_WORDS_OF_README = 910


def files_of(room: str) -> list[Path]:
    folder = ROOT / room.removesuffix("/.")
    return sorted(folder.glob("*.py" if room.endswith("/.") else "**/*.py"))


def is_value_type(node: ast.AST) -> bool:
    if not isinstance(node, ast.ClassDef):
        return False
    decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
    bases = [ast.unparse(base).rpartition(".")[2] for base in node.bases]
    return any("dataclass" in d for d in decorators) or bool(
        {"NamedTuple", "TypedDict", "Struct"} & set(bases)
    )


def price_of(room: str) -> tuple[int, int, int]:
    """Return the nodes, the value types and the public names of a room."""
    nodes = 0
    types = 0
    names = 0
    for path in files_of(room):
        parsed = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(parsed):
            nodes += 1
            types += is_value_type(node)
        for node in parsed.body:
            is_name = isinstance(node, ast.FunctionDef | ast.ClassDef)
            names += is_name and not node.name.startswith("_")
    return nodes, types, names


def words_in(*paths: Path) -> int:
    return sum(len(path.read_text(encoding="utf-8").split()) for path in paths)


@pytest.mark.parametrize("room", [room for room in PRICES if room not in gone_rooms()])
def test_a_room_keeps_its_price(room: str) -> None:
    price = PRICES[room]
    cost = price_of(room)
    for kind, most, is_now in zip(("nodes", "types", "names"), price[:3], cost, strict=True):
        assert is_now <= most, f"{room} ({price.gain}) costs {is_now} {kind}, and may cost {most}"


def test_every_room_has_a_price() -> None:
    rooms = {
        f"validation/{path.name}"
        for path in (ROOT / "validation").iterdir()
        if list(path.glob("*.py"))
    }
    rooms |= {room for room in ("ssmr", "benchmarks") if (ROOT / room).is_dir()}
    assert rooms | {"validation/."} == set(PRICES) - gone_rooms()


@pytest.mark.parametrize("name", OPTIONS)
def test_a_program_keeps_its_options(name: str) -> None:
    own = getattr(import_module(f"validation.{name}"), name)
    assert len(own.__signature__.parameters) <= OPTIONS[name]


def test_the_whole_keeps_its_size() -> None:
    assert sum(len(files_of(name)) for name in ("ssmr", "validation", "benchmarks")) <= MOST_FILES
    assert words_in(ROOT / "README.md") <= MOST_WORDS_OF_README
