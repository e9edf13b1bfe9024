"""The recording sink: all is read back from the file, which is whole or not there."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import logging
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from ssmr.types import Commands, FloatArray, State, Trajectory
from tests.conftest import metrics_of
from validation.descriptions.loading import load_robot
from validation.experiment.runs import Run
from validation.experiment.scores import Scores
from validation.experiment.sources import Piece, Source
from validation.plants.profile import load_profile
from validation.report import scene_robots
from validation.report.comparison import Comparison
from validation.report.scene_robots import POSE_PERIOD, looks_of
from validation.report.viewer import open_viewer
from validation.simulator.description import WHEELS

SINGLE = 2.0**-22
"""Relative: what a number in double precision loses when rerun keeps it in single, with room for an
operation or two."""
PLANTS = ("mujoco", "improved", "coulomb", "linear", "kinematic")
RADIUS = 0.165
COLOUR = re.compile(r"\x1b\[[\d;]*m")  # rerun writes the parts of an address in different ones
UNRATED = metrics_of(*[0.0] * 8)


@pytest.fixture(autouse=True)
def strict_rerun() -> Iterator[None]:
    """Any misuse of rerun is an error."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def stamps(period: float, last: float, first: float = 0.0) -> FloatArray:
    """(M,) stamps from `first` to `last` [s]."""
    return np.asarray(
        first + period * np.arange(round((last - first) / period) + 1), dtype=np.float64
    )


def arc(
    speed: float, yaw_rate: float, t: FloatArray, start: Sequence[float] = (0.0, 0.0, 0.0)
) -> Trajectory:
    """A drive along a circle at constant speed, its wheels rolling.

    Wheel loads, torques and accelerations made up.
    """
    angle = yaw_rate * (t - t[0])
    one = np.ones(len(t))
    x = speed / yaw_rate * np.sin(angle)
    y = speed / yaw_rate * (1.0 - np.cos(angle))
    c = math.cos(start[2])
    s = math.sin(start[2])
    pose = np.column_stack([start[0] + c * x - s * y, start[1] + s * x + c * y, start[2] + angle])
    wheels = np.outer(one, [speed - 0.5 * yaw_rate, speed + 0.5 * yaw_rate]) / RADIUS
    channels = {
        "wheel_load_N": np.outer(one, [180.0, 181.0, 182.0, 183.0]) + np.sin(t)[:, None],
        "torque_N_m": np.outer(t, [1.0, 2.0]),
        "yaw_acceleration_rad_s2": 0.1 * t,
        "force_x_N": np.outer(1.0 + t, [-60.0, 61.0, -62.0, 63.0]),
        "force_y_N": np.outer(one, [-50.0, -51.0, 52.0, 53.0]),
    }
    return Trajectory(t, pose, np.outer(one, [speed, 0.0, yaw_rate]), wheels, channels)


def without(trajectory: Trajectory, *names: str) -> Trajectory:
    return replace(
        trajectory, channels={k: v for k, v in trajectory.channels.items() if k not in names}
    )


def comparison(
    times: Sequence[FloatArray], plants: Sequence[str] = PLANTS, speed: float = 0.5
) -> Comparison:
    """Plants on slightly different circles, MuJoCo's the reference."""
    pieces = {}
    for k, name in enumerate(plants):
        made = tuple(arc(speed + 0.02 * k, 0.8, t, (float(t[0]), 0.1 * k, 3.0)) for t in times)
        pieces[name] = (
            made
            if name == "mujoco"
            else tuple(without(p, "wheel_load_N", "force_x_N") for p in made)
        )
    commands = tuple(
        Commands(0.05, np.tile([speed, 0.8], (max(1, round((t[-1] - t[0]) / 0.05)), 1)))
        for t in times
    )
    runs = {name: Run(name, p, wall_s=0.1) for name, p in pieces.items()}
    options = {"input": "commands", "noise": False, "horizons": [6.0]}
    return compared(
        "traj4",
        pieces[plants[0]],
        commands,
        runs,
        seed=3,
        options=options,
        versions={"mujoco": "3.17"},
    )


def compared(
    source: str,
    truth: Sequence[Trajectory],
    commands: Sequence[Commands],
    runs: Mapping[str, Run],
    **more: Any,
) -> Comparison:
    """A comparison of plants with the first of them, of which only the motions matter."""
    pieces = tuple(Piece(given, State(), None, None) for given in commands)
    about: dict[str, Any] = {
        "title": source,
        "source": Source(source, pieces, "mujoco", 0.01),
        "profile": load_profile("thesis-lab"),
        "reference": next(iter(runs)),
        "truth": tuple(truth),
        "runs": runs,
        "scores": dict.fromkeys(runs, Scores(UNRATED)),
        "seed": 0,
    }
    return Comparison(**(about | more))


def against_a_recording(made: Comparison) -> Comparison:
    """The same, its reference recorded: a motion that is no plant's and has no channels."""
    recorded = tuple(
        replace(p, pose=np.add(p.pose, (0.0, 1.0, 2.0 * math.pi)), channels={}) for p in made.truth
    )
    return replace(made, reference="recording", truth=recorded)


@dataclass(frozen=True)
class Read:
    """What a file holds, by entity: static components, and components over time."""

    static: Mapping[str, Mapping[str, Any]]
    over_time: Mapping[str, Mapping[str, tuple[FloatArray, list[Any]]]]

    @classmethod
    def file(cls, path: Path) -> Read:
        """Read all chunks of a file."""
        static: dict[str, dict[str, Any]] = {}
        over_time: dict[str, dict[str, tuple[FloatArray, list[Any]]]] = {}
        for chunk in RrdReader(path).stream():
            batch = chunk.to_record_batch()
            entity = chunk.entity_path.removeprefix("/")
            names = [n for n in batch.schema.names if n not in ("rerun.controls.RowId", "sim_time")]
            if chunk.is_static:
                static.setdefault(entity, {}).update(
                    {n: batch.column(n).to_pylist()[0] for n in names}
                )
                continue
            assert chunk.timeline_names == ["sim_time"]
            at = 1e-9 * np.array(batch.column("sim_time").cast("int64").to_pylist())
            over_time.setdefault(entity, {}).update(
                {n: (at, batch.column(n).to_pylist()) for n in names}
            )
        return cls(static, over_time)

    def track(self, entity: str, component: str) -> tuple[FloatArray, FloatArray]:
        """(M,) stamps and (M, k) values."""
        at, values = self.over_time[entity][component]
        return at, np.array(values, dtype=np.float64).reshape(len(at), -1)


TWO_SECONDS = stamps(0.008, 2.0)
A_MOMENT = stamps(0.008, 0.08)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, Path, Read]:
    """Five plants over two seconds: what went in, the file, and what it holds."""
    made = comparison([TWO_SECONDS])
    path = tmp_path_factory.mktemp("recording") / "a.rrd"
    made.record(path)
    return made, path, Read.file(path)


@pytest.fixture(scope="module")
def in_pieces(tmp_path_factory: pytest.TempPathFactory) -> tuple[Comparison, Read]:
    """Three plants and a recording with two gaps."""
    times = [stamps(0.05, 11.0, 10.0), stamps(0.05, 13.5, 12.0), stamps(0.05, 20.5, 20.0)]
    made = against_a_recording(comparison(times, PLANTS[:3]))
    path = tmp_path_factory.mktemp("pieces") / "b.rrd"
    made.record(path)
    return made, Read.file(path)


def run_rerun(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).with_name("rerun")
    return subprocess.run([program, *arguments], capture_output=True, text=True, check=False)


# --- what is in the file ---


@pytest.mark.parametrize("plant", PLANTS)
def test_the_poses_read_back_are_those_given(
    shown: tuple[Comparison, Path, Read], plant: str
) -> None:
    made, _, read = shown
    motion = made.runs[plant].motions[0]
    t, translation = read.track(f"world/{plant}/robot", "Transform3D:translation")
    _, quat_xyzw = read.track(f"world/{plant}/robot", "Transform3D:quaternion")
    rows = np.searchsorted(motion.t, t - 1e-6)
    assert np.abs(motion.t[rows] - t).max() < 1e-9  # the file counts nanoseconds
    assert rows[0] == 0
    assert rows[-1] == len(motion) - 1
    assert np.diff(t).max() < POSE_PERIOD + 0.008 + 1e-9
    wanted = np.column_stack([motion.xy, np.zeros(len(motion))])[rows]
    assert np.abs(translation - wanted).max() <= SINGLE * np.abs(wanted).max()
    half = 0.5 * motion.yaw[rows]
    wanted = np.column_stack([np.zeros((len(half), 2)), np.sin(half), np.cos(half)])
    assert np.abs(quat_xyzw - wanted).max() <= SINGLE
    heading = Rotation.from_quat(quat_xyzw).apply([1.0, 0.0, 0.0])
    assert (
        np.abs(heading[:, :2] - np.column_stack([np.cos(2.0 * half), np.sin(2.0 * half)])).max()
        <= 4.0 * SINGLE
    )


def test_a_long_recording_is_thinned(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(scene_robots, "MOST_POSES", 50)
    monkeypatch.setattr(scene_robots, "MOST_SAMPLES", 60)
    made = comparison([TWO_SECONDS], PLANTS[:2])
    path = tmp_path / "long.rrd"
    made.record(path)
    read = Read.file(path)
    motion = made.runs["improved"].motions[0]
    at, places = read.track("world/improved/robot", "Transform3D:translation")
    assert len(at) <= 52
    assert np.allclose(places[-1, :2], motion.xy[-1], atol=1e-6)
    assert len(read.static["world/improved/path"]["LineStrips3D:strips"][0]) == len(at)
    assert len(read.track("plots/speed/improved", "Scalars:scalars")[0]) <= 60


@pytest.mark.parametrize(("speed", "direction"), [(0.5, -1.0), (-0.5, 1.0)])
def test_wheels_roll_the_way_the_robot_drives(
    tmp_path: Path, speed: float, direction: float
) -> None:
    t = stamps(0.01, 0.1)
    comparison([t], ["mujoco"], speed).record(tmp_path / "a.rrd")
    read = Read.file(tmp_path / "a.rrd")
    turned = {}
    for wheel in WHEELS:
        _, quat_xyzw = read.track(f"world/mujoco/robot/{wheel}", "Transform3D:quaternion")
        contact = Rotation.from_quat(quat_xyzw).apply([0.0, 0.0, -RADIUS])
        assert np.abs(contact[0] - [0.0, 0.0, -RADIUS]).max() <= SINGLE
        # the contact point moves against the drive
        assert np.all(np.diff(direction * contact[:, 0]) > 0.0)
        assert np.abs(contact[:, 1]).max() <= SINGLE
        turned[wheel] = math.asin(-contact[-1, 0] / RADIUS)
    left = (speed - 0.4) * t[-1] / RADIUS
    right = (speed + 0.4) * t[-1] / RADIUS
    wanted = {w: left if w.endswith("left") else right for w in WHEELS}
    assert turned == pytest.approx(wanted, rel=1e-5)  # single precision through an arc sine


def test_forces_of_the_ground_are_arrows_of_one_scale_where_a_plant_tells_them(
    shown: tuple[Comparison, Path, Read],
) -> None:
    made, _, read = shown
    motion = made.runs["mujoco"].motions[0]
    at, arrows = read.over_time["world/mujoco/robot/contact_force"]["Arrows3D:vectors"]
    rows = np.searchsorted(motion.t, at - 1e-6)
    names = ("force_x_N", "force_y_N", "wheel_load_N")
    forces = np.stack([motion.channels[name][rows] for name in names], axis=-1)
    factor = np.array(arrows) / forces
    assert factor.min() > 0.0
    assert factor.max() == pytest.approx(factor.min(), rel=2.0 * SINGLE)
    told = {plant for plant in PLANTS if f"world/{plant}/robot/contact_force" in read.over_time}
    assert told == {"mujoco"}
    for name in names[:2]:
        _, values = read.track(f"plots/{name.removesuffix('_N')}/mujoco", "Scalars:scalars")
        assert values.shape == (len(motion), 4)


def test_the_centre_of_rotation_of_a_circle_is_its_middle(
    shown: tuple[Comparison, Path, Read],
) -> None:
    """A robot on a left circle with v = 0.5 m/s and 0.8 rad/s turns about a point beside it."""
    _, _, read = shown
    _, points = read.over_time["world/mujoco/robot/rotation_centre"]["Points3D:positions"]
    assert np.abs(np.array(points)[:, 0] - [0.0, 0.5 / 0.8, 0.0]).max() < 1e-6
    _, ahead = read.track("plots/rotation_centre/mujoco", "Scalars:scalars")
    assert np.abs(ahead).max() < 1e-6


def test_a_robot_that_drives_straight_has_no_centre_of_rotation(tmp_path: Path) -> None:
    turning = comparison([A_MOMENT], ["mujoco"])
    straight = replace(turning.truth[0], twist=turning.truth[0].twist * [1.0, 1.0, 0.0])
    result = Run("mujoco", (straight,), wall_s=0.1)
    made = compared(
        "straight",
        (straight,),
        [piece.commands for piece in turning.source.pieces],
        {"mujoco": result},
    )
    made.record(tmp_path / "straight.rrd")
    read = Read.file(tmp_path / "straight.rrd")
    _, points = read.over_time["world/mujoco/robot/rotation_centre"]["Points3D:positions"]
    assert not any(points)
    _, ahead = read.track("plots/rotation_centre/mujoco", "Scalars:scalars")
    assert np.isnan(ahead).all()


def test_nothing_is_drawn_across_gaps(in_pieces: tuple[Comparison, Read]) -> None:
    made, read = in_pieces
    for name in ("recording", *PLANTS[:3]):
        assert len(read.static[f"world/{name}/path"]["LineStrips3D:strips"]) == 3
    wanted = np.concatenate([p.t for p in made.truth])
    for entity, columns in read.over_time.items():
        if not entity.startswith("plots/"):
            continue
        t, _ = columns["Scalars:scalars"]
        breaks, _ = columns["Clear:is_recursive"]
        assert breaks == pytest.approx([11.5, 16.75])
        assert not np.any(
            (t > 11.0 + 1e-6) & (t < 12.0 - 1e-6) | (t > 13.5 + 1e-6) & (t < 20.0 - 1e-6)
        )
        if not entity.endswith("commanded"):
            assert t == pytest.approx(wanted)
    t, _ = read.track("world/coulomb/robot", "Transform3D:translation")
    assert t == pytest.approx(wanted)


@pytest.mark.parametrize("t", [stamps(0.008, 0.0), stamps(0.008, 0.032)])
def test_a_robot_that_stands_still_can_be_shown(tmp_path: Path, t: FloatArray) -> None:
    still = Trajectory(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)), np.zeros((len(t), 2)))
    result = Run("kinematic", (still,), wall_s=0.1)
    commands = (Commands(0.008, np.zeros((max(1, len(t) - 1), 2))),)
    compared("a", (still,), commands, {"kinematic": result}).record(tmp_path / "a.rrd")
    assert (
        len(
            Read.file(tmp_path / "a.rrd").track("world/kinematic/robot", "Transform3D:translation")[
                0
            ]
        )
        >= 1
    )


# --- the file ---


def test_a_repeated_run_compares_equal_and_another_has_another_id(
    shown: tuple[Comparison, Path, Read], tmp_path: Path
) -> None:
    path = shown[1]
    for name, other in (
        ("same", comparison([TWO_SECONDS])),
        ("moved", comparison([TWO_SECONDS], speed=0.51)),
    ):
        other.record(tmp_path / f"{name}.rrd")
    assert run_rerun("rrd", "compare", "--unordered", path, tmp_path / "same.rrd").returncode == 0
    files = (path, *(tmp_path / f"{name}.rrd" for name in ("same", "moved")))
    ids = [RrdReader(file).recordings()[0].recording_id for file in files]
    assert ids[0] == ids[1]
    assert ids[2] != ids[0]


def raiser(failure: BaseException) -> Callable[..., None]:
    def fail(*_: object) -> None:
        raise failure

    return fail


def test_a_failure_leaves_nothing_and_spares_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.rrd"
    made = comparison([A_MOMENT], PLANTS[:2])
    path.write_bytes(b"before")
    twice = replace(made.source, pieces=made.source.pieces * 2)
    with pytest.raises(ValueError, match="zip"):
        replace(made, source=twice).record(path)
    for failure in (OSError("no space left"), KeyboardInterrupt()):
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", raiser(failure))
            with pytest.raises(type(failure)):
                made.record(path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.rrd"]
    assert path.read_bytes() == b"before"
    with pytest.raises(FileNotFoundError):
        made.record(tmp_path / "nowhere" / "a.rrd")


# --- the viewer ---


class FakeViewer:
    """A viewer that stays, ends at once, or cannot be started."""

    def __init__(self, fate: str) -> None:
        self.fate = fate
        self.command = list[str]()

    def __call__(self, command: list[str], **_: object) -> FakeViewer:
        """Start."""
        if self.fate == "missing":
            raise FileNotFoundError("no such program")
        self.command = command
        return self

    def wait(self, seconds: float) -> int:
        """Wait for its end."""
        if self.fate == "stays":
            raise subprocess.TimeoutExpired(self.command, seconds)
        return 0


@pytest.mark.parametrize(("fate", "opened"), [("stays", True), ("ends", False), ("missing", False)])
def test_the_viewer_listens_on_loopback_or_its_absence_is_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, fate: str, opened: bool
) -> None:
    viewer = FakeViewer(fate)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(subprocess, "Popen", viewer)
    with caplog.at_level(logging.WARNING):
        assert open_viewer(Path("a.rrd")) == opened
    assert bool(caplog.text) != opened
    if fate != "missing":
        assert viewer.command[viewer.command.index("--bind") + 1] == "127.0.0.1"


# --- the robot's looks ---


@pytest.mark.parametrize("name", ["husky", "jackal"])
def test_a_robot_looks_as_large_as_it_is(name: str) -> None:
    """Hull and wheels have the robot's numbers; a mast adds at most a quarter of the hull."""
    robot = load_robot(name)
    looks = looks_of(load_robot(name))
    radius, track, (long, _, high) = robot.wheel_radius, robot.track, robot.body_size
    length = max(long, robot.wheelbase + 2.0 * radius)
    hull_top = looks.places["base"][2] + robot.body_centre[2] + 0.5 * high
    assert looks.size[:2] == pytest.approx([length, track + robot.wheel_width], rel=0.01)
    top = max(2.0 * radius, hull_top)
    assert top <= looks.size[2] <= top + 0.25 * high
    for wheel in WHEELS:
        x, y, z = looks.places[wheel]
        assert z == pytest.approx(radius)
        assert abs(y) == pytest.approx(0.5 * track)
        assert (x > 0.0) == wheel.startswith("front")
        assert (y > 0.0) == wheel.endswith("left")
        sizes = [size[0] for solids in looks.solids[wheel].values() for size, *_ in solids]
        assert max(sizes) == pytest.approx(radius, rel=0.02)
