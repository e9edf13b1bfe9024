"""Controllers from a user's file: they drive, and what is wrong with them is said in one line with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssmr.control.law import Observation
from ssmr.control.references import line
from ssmr.errors import ControllerError
from validation.bench.loops import chosen_controller
from validation.bench.user_law import load_user_law
from validation.plants.profile import load_profile
from validation.ros.follower import PathFollower
from validation.track import track

GOOD = '''"""A controller."""

from dataclasses import dataclass


@dataclass
class Mine:
    mission: object

    def command(self, now):
        m = self.mission
        return now.target.v + now.errors.rho, 2.0 * now.errors.y + now.errors.alpha


def make(mission):
    return Mine(mission)


number = 3
'''


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.py"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["Mine", "make"])
@pytest.mark.parametrize("plant", ["improved", "mujoco"])
def test_a_users_class_drives_like_the_law_that_it_is(tmp_path: Path, name: str, plant: str) -> None:
    path = written(tmp_path, GOOD)
    tracked = track(f"{path}:{name}", line(0.5, 2.0), plant, feedback="truth", no_disturbance=True)
    assert not tracked.robots[0].run.lost
    assert 0.0 < tracked.metrics["d_rms_m"] < 0.1
    assert tracked.as_dict()["controller"] == name
    assert tracked.as_dict()["gains"] == {}


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        (GOOD, "Yours", r"mine\.py has no class 'Yours'; it has: Mine"),
        ("class Mine:\n    pass\n", "Mine", r"mine\.py:1: class Mine has no method command"),
        ("\n\nclass Mine\n", "Mine", r"mine\.py:3: SyntaxError"),
        ("import nothing_of_the_kind\n", "Mine", r"mine\.py:1: ModuleNotFoundError: No module named"),
        ("x = 1\ny = x / 0\n", "Mine", r"mine\.py:2: ZeroDivisionError: division by zero"),
        (GOOD, "not a name", r"names no class; wanted FILE\.py:NAME"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path: Path, text: str, name: str, said: str) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        load_user_law(f"{written(tmp_path, text)}:{name}")
    assert "\n" not in str(caught.value)


FAULTS = [
    ("return 1.0 / 0.0, 0.0", r"mine\.py:6: ZeroDivisionError: .* \(in Mine\.command at t = 0\.00 s\)"),
    ("return helper(now)", r"mine\.py:9: KeyError: 'way' \(in Mine\.command"),
    ("return float('nan'), 0.0", r"mine\.py:5: command returned \(nan, 0\.0\) at t = 0\.00 s; wanted speed"),
    ("return 'ab'", "command returned 'ab'"),
    ("raise SystemExit", r"mine\.py:6: SystemExit"),
    ("raise ValueError('two\\nlines')", "ValueError: two.?lines"),
]
FAULTY = """class Mine:
    def __init__(self, mission):
        self.mission = mission

    def command(self, now):
        {}

def helper(now):
    return {{}}['way']
"""


@pytest.mark.parametrize(("body", "said"), FAULTS)
def test_a_fault_inside_is_said_with_its_line(tmp_path: Path, body: str, said: str) -> None:
    path = written(tmp_path, FAULTY.format(body))
    with pytest.raises(ControllerError, match=said) as caught:
        track(f"{path}:Mine", line(0.5, 1.0))
    assert "\n" not in str(caught.value)


def driven(follower: PathFollower) -> None:
    """Messages of a robot that stands at its start, and commands."""
    for k in range(40):
        follower.update(10.0 + 0.02 * k, Observation(0.0, 0.0, 0.0, 0.0, 0.0), 0.02 * k)
        if follower.phase == "driving":
            follower.command(0.02 * k)


def test_behind_ros_a_fault_ends_the_drive(tmp_path: Path) -> None:
    lab = load_profile("thesis-lab")
    good, _ = chosen_controller(f"{written(tmp_path, GOOD)}:Mine", lab)
    driven(PathFollower(good, line(0.5, 2.0)))
    late = FAULTY.format("return (0.1, 0.0) if now.t < 0.3 else 1 / 0")
    bad, _ = chosen_controller(f"{written(tmp_path, late)}:Mine", lab)
    with pytest.raises(ControllerError, match=r"mine\.py:6: ZeroDivisionError"):
        driven(PathFollower(bad, line(0.5, 2.0)))
    worse, _ = chosen_controller(f"{written(tmp_path, FAULTY.format('return 1 / 0'))}:Mine", lab)
    with pytest.raises(ControllerError, match="ZeroDivisionError"):
        PathFollower(worse, line(0.5, 2.0))
