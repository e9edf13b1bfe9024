"""The nodes on a real ROS 1 graph, on loopback; where rospy or roscore is not there, these tests skip and say so."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.ros_floods import KINDS, flood
from validation import cli
from validation.ros import ros1
from validation.ros.port import NoGraphError
from validation.ros.ros1 import APT_PACKAGES, SET_POSE_MD5, load_rospy

ROOT = Path(__file__).resolve().parents[1]


def python(*arguments: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """A process of its own: rospy leaves a process as it found it less than tests want."""
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=timeout, check=False, cwd=ROOT
    )


@cache
def why_no_ros() -> str:
    """Why there is no ROS here; empty where there is."""
    if shutil.which("roscore") is None:
        return f"there is no roscore; on Debian 12: apt-get install --no-install-recommends {APT_PACKAGES}"
    loaded = python("-c", "from validation.ros.ros1 import load_rospy; load_rospy()")
    return loaded.stderr.strip().splitlines()[-1] if loaded.returncode else ""


@pytest.fixture
def graph() -> None:
    """A test that needs ROS."""
    if why := why_no_ros():
        pytest.skip(why)


def measured(tmp_path: Path, *options: str, timeout: float) -> dict[str, Any]:
    """Findings of benchmarks.ros by name; each must keep what was asked of it."""
    out = tmp_path / "ros.json"
    done = python("-m", "benchmarks.ros", "--out", str(out), *options, timeout=timeout)
    assert done.returncode == 0, done.stderr[-2000:]
    rows = json.loads(out.read_text(encoding="utf-8"))["rows"]
    assert [r for r in rows if not r["ok"]] == []
    return {r["what"]: r["value"] for r in rows}


@pytest.mark.parametrize(
    ("here", "more"), [((3, 11, 2), "std-srvs"), ((3, 12, 1), "; they are for Python 3.11, this is 3.12")]
)
def test_without_ros_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, here: tuple[int, ...], more: str
) -> None:
    monkeypatch.setattr(ros1, "_here", lambda: here)
    monkeypatch.setattr(sys, "path", sys.path[:])
    for name in ("rospy", "rosgraph"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        NoGraphError, match=r"^ROS 1 is not there \(.*apt-get install --no-install-recommends ros-core"
    ) as why:
        load_rospy()
    assert str(why.value).endswith(more)


@pytest.mark.usefixtures("graph")
def test_without_a_master_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    done = python("-m", "validation.ros", "sim", "--duration", "1")
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1].startswith("error: no ROS master answers at http://127.0.0.1:9")


@pytest.mark.usefixtures("graph")
def test_the_services_checksum_is_genmsgs() -> None:
    """What genmsg makes of `geometry_msgs/PoseWithCovarianceStamped pose`: the type's checksum in the place of its name."""
    code = (
        "from validation.ros.ros1 import load_rospy, message_class, set_pose_service; load_rospy();"
        "import io; m = message_class('geometry_msgs/PoseWithCovarianceStamped'); r = set_pose_service()._request_class();"
        "r.pose.pose.pose.position.x = 1.5; b = io.BytesIO(); r.serialize(b);"
        "s = set_pose_service()._request_class().deserialize(b.getvalue());"
        "print(m._md5sum, s.pose.pose.pose.position.x)"
    )
    checksum, x = python("-c", code).stdout.split()
    assert hashlib.md5(f"{checksum} pose".encode()).hexdigest() == SET_POSE_MD5
    assert float(x) == 1.5


@pytest.mark.usefixtures("graph")
def test_it_obeys_the_joystick_first_and_stops_on_silence_and_without_a_master(tmp_path: Path) -> None:
    found = measured(tmp_path, "--only", "behaviour", timeout=120.0)
    assert found["stream silent: at rest from 0.25 m/s after"] > 0.25


@pytest.mark.usefixtures("graph")
def test_a_flood_of_nonsense_is_a_few_lines_and_the_robot_stops() -> None:
    found = flood("nan", rate=1000.0, seconds=1.5)
    assert found.sent > 3000
    assert found.lines < 80
    assert found.errors == ()
    assert found.stop_s < 3.0, "0.4 s on a machine that does nothing else"
    assert found.exit_status == cli.EXIT_INTERRUPTED


@pytest.mark.slow
@pytest.mark.usefixtures("graph")
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("quiet", "nan")])
def test_no_flood_gets_through(kind: str) -> None:
    found = flood(kind, rate=100.0 if kind == "truncated" else 2000.0, seconds=2.0)
    assert found.lines < 100
    assert found.errors == ()
    assert not found.stop_s > 3.0
    assert found.exit_status in (cli.EXIT_INTERRUPTED, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("graph")
def test_rates_pacing_latency_the_circle_and_a_controller_without_a_master(tmp_path: Path) -> None:
    measured(tmp_path, "--only", "rates,latency,circle,orphans", "--repeats", "0", timeout=400.0)
