"""Controllers from a user's file: they drive, and a fault is one line with file and line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from ssmr import _jit
from ssmr.control.mission import ControllerInput
from ssmr.control.references import line
from ssmr.errors import ControllerError, SsmrError
from ssmr.models.law import OWN_MODELS
from validation.cli import parse_command
from validation.cli.__main__ import program_named
from validation.compare import compare
from validation.experiment.user_law import add_user_model, load_user_law, load_user_metric
from validation.fit import fit
from validation.plants.profile import load_profile
from validation.plants.table import plant_kind
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
def test_a_users_class_drives_like_the_law_that_it_is(
    tmp_path: Path, name: str, plant: str
) -> None:
    path = written(tmp_path, GOOD)
    tracked = track(f"{path}:{name}", line(0.5, 2.0), plant, feedback="truth", no_disturbance=True)
    assert not tracked.robots[0].run.lost
    assert 0.0 < tracked.metrics["d_rms_m"] < 0.1
    assert tracked.as_dict()["controller"] == name
    assert tracked.as_dict()["gains"] == {}


@pytest.mark.parametrize("words", [("track",), ("ros", "control")])
@pytest.mark.parametrize("at", [0, 1, 3])
@pytest.mark.parametrize("joined", [False, True])
def test_the_option_controller_names_the_first_argument(
    words: tuple[str, ...], at: int, joined: bool
) -> None:
    """Scripts may give a class of their own by `--controller`, anywhere behind the program."""
    program, *before = words
    rest = ["circle", "--speed", "0.4"]
    option = ["--controller=mine.py:Mine"] if joined else ["--controller", "mine.py:Mine"]
    read = [
        parse_command(program_named(program), program, [*before, *arguments])
        for arguments in (["mine.py:Mine", *rest], [*rest[:at], *option, *rest[at:]])
    ]
    first, second = (str(call).partition("controller=")[2] for call in read)
    assert first == second
    assert first.startswith("'mine.py:Mine', reference='circle'")


def test_another_programs_option_controller_stays() -> None:
    words = ["check", "husky", "--controller", "diff_drive.yaml"]
    read = parse_command(program_named("robots"), "robots", words)
    assert "diff_drive.yaml" in repr(read)


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (GOOD, "Yours", r"mine\.py has no 'Yours'; there are: Mine, make"),
        (GOOD, "number", r"mine\.py:number is 3, wanted a class"),
        ("class Mine:\n    pass\n", "Mine", r"mine\.py:1: class Mine has no method command"),
        ("\n\nclass Mine\n", "Mine", r"mine\.py:3: SyntaxError"),
        (
            "import nothing_of_the_kind\n",
            "Mine",
            r"mine\.py:1: ModuleNotFoundError: No module named",
        ),
        ("x = 1\ny = x / 0\n", "Mine", r"mine\.py:2: ZeroDivisionError: division by zero"),
        (GOOD, "not a name", r"names nothing in a file; wanted FILE\.py:NAME"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(
    tmp_path: Path, text: str, name: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_user_law(f"{written(tmp_path, text)}:{name}")
    assert "\n" not in str(caught.value)


FAULTS = [
    (
        "return 1.0 / 0.0, 0.0",
        r"mine\.py:6: ZeroDivisionError: .* \(in Mine\.command at t = 0\.00 s\)",
    ),
    ("return helper(now)", r"mine\.py:9: KeyError: 'way' \(in Mine\.command"),
    (
        "return float('nan'), 0.0",
        r"mine\.py:5: command returned \(nan, 0\.0\) at t = 0\.00 s; wanted speed",
    ),
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


@pytest.mark.parametrize(("body", "message"), FAULTS)
def test_a_fault_inside_is_said_with_its_line(tmp_path: Path, body: str, message: str) -> None:
    path = written(tmp_path, FAULTY.format(body))
    with pytest.raises(ControllerError, match=message) as caught:
        track(f"{path}:Mine", line(0.5, 1.0))
    assert "\n" not in str(caught.value)


class Follow:
    """A class that a notebook might have."""

    def __init__(self, mission: object) -> None:
        """Keep nothing."""

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the target's speeds and what the errors ask for besides."""
        return now.target.v + now.errors.rho, 2.0 * now.errors.y + now.errors.alpha


def test_a_class_itself_is_a_controller(tmp_path: Path) -> None:
    """It drives as its text does from a file."""
    path = written(tmp_path, GOOD)
    own = track(Follow, line(0.5, 2.0), no_noise=True)
    assert own.as_dict()["controller"] == "Follow"
    assert own.metrics == track(f"{path}:Mine", line(0.5, 2.0), no_noise=True).metrics


MODEL = '''"""A kinematic robot whose wheels slip."""

from dataclasses import dataclass

from ssmr._jit import jit
from ssmr.models.law import PlanarLaw
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.drive import Sides


@dataclass(frozen=True)
class SlipParameters:
    """Its one number."""

    slip: float = parameter(0.0, unit="1", low=0.0, high=1.0, search=(0.0, 0.5))

    def __post_init__(self):
        check_parameters(self)


@jit
def advance(v, w, wheels, integral, disturbance, robot):
    moved = 0.5 * robot.vehicle.wheel_radius * (1.0 - robot.parameters.slip)
    return moved * (wheels.left + wheels.right), 0.0 * w, Sides(0.0, 0.0)


def gap_m(motion, reference):
    return float(abs(motion.xy[-1, 0] - reference.xy[-1, 0]))


LAW = PlanarLaw("slip", SlipParameters, advance, ideal=True)

@dataclass(frozen=True)
class OtherParameters(SlipParameters):
    """A law's parameters are its own."""


NOTHING = jit(lambda v, w, wheels, disturbance, dt, robot: robot.parameters.nothing)
BAD = PlanarLaw("bad", OtherParameters, NOTHING)
TAKEN = PlanarLaw("linear", SlipParameters, advance)
'''


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The file of a model, whose plants are known to this test alone.

    What is compiled later is kept as before.
    """
    monkeypatch.setattr(_jit, "_saves", _jit._saves)
    with patch.dict(OWN_MODELS):
        yield written(tmp_path, MODEL)
    plant_kind.cache_clear()


def test_a_planar_model_and_a_metric_from_a_file_are_a_plant_and_a_column(own: Path) -> None:
    """One whose wheels slip by a tenth drives nine tenths of the way; an edited one, its edit."""
    file = own.with_name("p.toml")
    ways = list[float]()
    for slip, times in ((0.0, "1.0"), (0.1, "1.0"), (0.1, "2.0")):
        written(own.parent, MODEL.replace("1.0 - robot", f"1.0 - {times} * robot"))
        file.write_text(f'schema = "ssmr.profile/1"\n[plants.slip.parameters]\nslip = {slip}\n')
        comparison = compare(
            "traj4",
            file,
            ("kinematic",),
            "kinematic",
            own_model=f"{own}:LAW",
            own_metric=f"{own}:gap_m",
        )
        assert list(comparison.runs) == ["kinematic", "slip"]
        assert comparison.as_dict()["plants"]["kinematic"]["gap_m"] == 0.0
        assert (
            comparison.tables()[0].rows[1]["gap_m"]
            == comparison.scores["slip"].metrics["gap_m"]
            > 0.0
        )
        ways.append(
            float(np.hypot(*np.diff(comparison.runs["slip"].motions[0].xy, axis=0).T).sum())
        )
    assert ways == pytest.approx([ways[0], 0.9 * ways[0], 0.8 * ways[0]], rel=1e-9)
    assert not _jit._saves, (
        "what calls a user's code is not kept on disk, where it would outlive an edit"
    )


@pytest.mark.slow
def test_a_model_from_a_file_is_fitted(own: Path) -> None:
    fitted = fit(
        "slip",
        "traj4@kinematic",
        own_model=f"{own}:LAW",
        free=("slip",),
        population=8,
        generations=2,
    )
    fitted.profile.save(own.with_name("fitted.toml"))
    assert (
        load_profile(own.with_name("fitted.toml")).plants["slip"] == fitted.profile.plants["slip"]
    )


REFUSED = {
    "BAD": r"mine\.py:\d+: .*nothing.* \(model bad\)",
    "TAKEN": "cannot be named 'linear'",
    "gap_m": "a PlanarLaw",
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_model_that_cannot_be_is_refused(own: Path, name: str) -> None:
    with pytest.raises(ValueError, match=REFUSED[name]) as caught:
        add_user_model(f"{own}:{name}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("body", "message"),
    [("1 / 0", r"mine\.py:2: ZeroDivisionError"), ("float('nan')", "returned nan")],
)
def test_a_metric_that_fails_is_said_with_its_line(tmp_path: Path, body: str, message: str) -> None:
    path = written(tmp_path, f"def mine_m(motion, reference):\n    return {body}\n")
    with pytest.raises(SsmrError, match=message):
        track("pid", line(0.5, 1.0), own_metric=f"{path}:mine_m")
    with pytest.raises(ValueError, match="there is a metric d_rms_m already"):
        load_user_metric(f"{written(tmp_path, 'def d_rms_m(m, r): return 0.0')}:d_rms_m")
