"""Imports run one way, and the pure part stays pure."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

LAYERS = (
    {"ssmr.errors", "ssmr._jit", "ssmr.types"},
    {"ssmr.geometry", "ssmr.friction", "ssmr.vehicle", "ssmr.scenarios", "ssmr.space", "ssmr.jde", "ssmr.surface"},
    {"ssmr.drive", "ssmr.sensors", "ssmr.ekf", "ssmr.metrics", "ssmr.waypoints", "ssmr.loads"},
    {
        *("ssmr.models.coulomb", "ssmr.models.improved", "ssmr.models.linear", "ssmr.models.kinematic"),
        *("ssmr.references", "ssmr.controllers.pid", "ssmr.controllers.lqr"),
    },
    {"ssmr.simulate", "ssmr.controllers.scheduled", "ssmr.controllers.smc"},
    {"ssmr.controllers.laws"},
    {"ssmr.closed_loop"},
    {
        "validation.store",
        "validation.cli",
        "validation.palette",
        "validation.published",
        "validation.terrain",
        "validation.physics_settings",
        "validation.skid_turn",
        "validation.recording",
        *("validation.pacing", "validation.ros_commands", "validation.ros_messages"),
        "validation.verdicts",
    },
    {"validation.husky", "validation.rerun_ground"},
    {
        *("validation.mujoco_plant", "validation.robot_mesh", "validation.bags", "validation.signals"),
        *("validation.ros_pilot", "validation.ros_port"),
    },
    {
        *("validation.profiles", "validation.wheel_loads", "validation.drawing", "validation.husky_loops"),
        *("validation.bag_recording", "validation.dead_reckoning", "validation.recording_export", "validation.ros_robot"),
    },
    {"validation.results"},
    {
        "validation.ros_sim",
        "validation.searchable",
        "validation.search",
        "validation.sources",
        "validation.waypoint_files",
        "validation.gains",
        "validation.tables",
        "validation.figures",
        "validation.rerun_log",
        "validation.fit_report",
        "validation.fit_figure",
        "validation.fit_rerun",
        "validation.track_report",
        "validation.track_figure",
        "validation.track_rerun",
        "validation.tune_report",
        "validation.tune_figure",
        "validation.response_figure",
        "validation.residual_figure",
    },
    {
        *("validation.driving", "validation.tracking", "validation.learning", "validation.recording_report"),
        *("validation.ros_control", "validation.evidence"),
    },
    {
        "validation.compare",
        "validation.population",
        "validation.control_tables",
        "validation.robustness",
        "validation.robustness_figure",
        "validation.filter_study",
        "validation.filter_figure",
        "validation.terrain_study",
        "validation.terrain_figure",
        "validation.simulated_log",
        "validation.contact_bench",
        "validation.evidence_tables",
        "validation.evidence_report",
    },
    {
        *("validation.objective", "validation.tuning", "validation.contact_study", "validation.contact_figure"),
        *("validation.evidence_real", "validation.html_page"),
    },
    {"validation.targets", "validation.uncertainty", "validation.cluster", "validation.gain_study"},
    {"validation.fitting"},
    {
        *("validation.fit", "validation.track", "validation.tune", "validation.study", "validation.recordings"),
        *("validation.ros", "validation.evidence_models"),
    },
    {"validation.evidence_control"},
    {"validation.replicate"},
)
"""A module imports only from layers above its own, so there is no cycle."""

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
            if not name.endswith("__init__"):
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


def test_every_module_has_its_layer() -> None:
    assert set(modules()) == set().union(*LAYERS)


@pytest.mark.parametrize("name", sorted(modules()))
def test_imports_run_one_way(name: str) -> None:
    layer = next(i for i, members in enumerate(LAYERS) if name in members)
    above = set().union(*LAYERS[:layer])
    ours = imports(modules()[name]) & set(modules())
    same = ours & LAYERS[layer]
    assert ours - same <= above, f"{name} imports from below: {sorted(ours - same - above)}"
    for other in same:
        assert name not in imports(modules()[other]), f"{name} and {other} import each other"


@pytest.mark.parametrize("name", sorted(n for n in modules() if n.startswith("ssmr")))
def test_ssmr_is_pure(name: str) -> None:
    used = imports(modules()[name])
    allowed = {"time"} if name == "ssmr._jit" else set()  # the age of a compiler cache
    banned = {u for u in used if u in BANNED_IN_SSMR or u.split(".")[0] in BANNED_IN_SSMR} - allowed
    assert not banned, f"{name} imports {sorted(banned)}"


def test_only_the_compiler_cache_touches_files() -> None:
    for name, path in modules().items():
        if name.startswith("ssmr") and name != "ssmr._jit":
            assert not imports(path) & {"os", "pathlib", "tempfile", "shutil", "io"}, name


def test_no_package_hides_code_in_its_init() -> None:
    for package in ("ssmr", "ssmr/models", "validation"):
        tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
        assert all(isinstance(node, ast.Expr) for node in tree.body), package


def test_one_module_knows_rospy() -> None:
    """Everything else of the nodes is tested without ROS."""
    packages = {"rospy", "rosgraph", "genpy", "rosgraph_msgs", *(f"{kind}_msgs" for kind in ("geometry", "nav", "sensor"))}
    for name, path in modules().items():
        used = {u.split(".")[0] for u in imports(path)} & packages
        assert not used or name == "validation.ros_port", f"{name} imports {sorted(used)}"
