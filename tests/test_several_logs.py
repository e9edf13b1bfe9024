"""Fits of several logs.

One body and a localiser for each log come back, days tell how much they differ, and a profile is a
prior.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from ssmr.simulation import PlanarPlant
from ssmr.types import Commands, FloatArray, State
from validation.calibrate import calibrate
from validation.compare import compare
from validation.descriptions.loading import load_robot
from validation.experiment.sources import open_source
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.fit import Fitted, fit
from validation.identify.adapting import Calibrating, adapted_along
from validation.identify.targets import split_ground, tags_of
from validation.plants.planar import _model_of
from validation.plants.profile import bare_profile, load_profile
from validation.plants.searchable import OF_A_LOG, own_indices, split_by_log, with_values

BODY = {"alpha_l": 0.95, "alpha_r": 0.92, "y_l": 0.45, "y_r": -0.5, "drift": 0.1, "tracked_x": 0.1}
DAYS = (
    {"tracked_yaw": 0.03, "position_late": 0.15, "yaw_late": 0.05},
    {"tracked_yaw": -0.02, "position_late": 0.3, "yaw_late": 0.35},
    {"tracked_yaw": 0.01, "position_late": -0.1, "yaw_late": 0.2},
    {"tracked_yaw": 0.0, "position_late": 0.2, "yaw_late": 0.1},
)


BARE = bare_profile(load_robot("husky"))


def drive(
    folder: Path,
    name: str,
    numbers: dict[str, float],
    seed: int,
    kind: Literal["wheels", "twist"] = "wheels",
    seconds: float = 60.0,
) -> Path:
    """Write a log of a robot with these numbers, with 5 mm and 3 mrad of noise on its poses.

    It is driven by wheel rates or by commands.
    """
    true = with_values("kinematic", BARE.plants["kinematic"], list(numbers), numbers.values())
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(round(seconds / 0.01))
    periods = rng.uniform(0.2, 0.6, (2, 6))
    phases = rng.uniform(0.0, 6.0, (2, 6))

    def rates(at: FloatArray) -> FloatArray:
        """Return (M, 2) wheel rates, slow enough for lines between samples [rad/s]."""
        v, w = np.sin(at[:, None, None] * periods + phases).sum(axis=2).T
        if kind == "twist":
            return np.column_stack([0.1 + 0.1 * v, 0.2 * w])
        return np.column_stack([0.6 + v - w, 0.6 + v + w])

    driven = Commands(0.01, rates(t + 0.005), kind)
    motion = PlanarPlant(_model_of(true)).run(driven, State(), 0.01)
    t = t[::5]
    pose = true.localiser.logged_poses(motion.pose, 0.01, t)
    pose = pose + rng.normal(0.0, (0.005, 0.005, 0.003), pose.shape)
    left, right = rates(t).T
    names = ("enc_left", "enc_right") if kind == "wheels" else ("cmd_v", "cmd_w")
    columns = {"t": t, names[0]: left, names[1]: right}
    columns |= dict(zip(("x", "y", "yaw"), pose.T, strict=True))
    write_csv(Log.of_columns(name, columns), folder / f"{name}.csv")
    return folder / f"{name}.csv"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three days of one body."""
    folder = tmp_path_factory.mktemp("days")
    return [drive(folder, f"day{k}", {**BODY, **DAYS[k]}, k, seconds=80.0) for k in range(3)]


@pytest.fixture(scope="module")
def together(logs: list[Path]) -> Fitted:
    return fit("kinematic", logs, profile=BARE, input="wheels")


def test_one_body_and_a_localiser_for_each_log_come_back(together: Fitted) -> None:
    found = {p.name: p for p in together.parameters}
    truth = dict(BODY)
    for k, day in enumerate(DAYS[:3]):
        truth |= {f"{name}@day{k}": value for name, value in day.items()}
    assert set(found) == set(truth)
    for name, value in truth.items():
        assert abs(found[name].value - value) < 3.0 * found[name].standard_error, name
    for name in BODY:
        assert found[name].standard_error < 0.02, name
    plant = together.plant
    late = [day["position_late"] for day in DAYS[:3]]
    assert min(late) < plant.localiser.position_late < max(late)
    assert plant.spread["position_late"] == pytest.approx(np.std(late, ddof=1), rel=0.2)
    assert plant.spread["y_l"] < 0.05


def test_a_log_that_is_only_judged_has_nothing_of_its_own(
    together: Fitted, logs: list[Path], tmp_path: Path
) -> None:
    plant = together.plant
    mean = {name: getattr(plant.localiser, name) for name in OF_A_LOG}
    new = drive(tmp_path, "new", {**BODY, **mean}, 9)
    out = tmp_path / "out"
    options: dict[str, Any] = {"profile": BARE, "plants": ("kinematic",), "trust": True}
    calibrate(logs, held_out=new, **options).save(out)
    profile = load_profile(out / "profile.toml")
    assert profile.plants["kinematic"].localiser == plant.localiser
    assert "kinematic by wheels to day0.csv, day1.csv, day2.csv" in profile.description
    assert profile.unfitted(["kinematic", "mujoco"])[0].startswith("nothing was fitted to mujoco")
    wheels = profile.provenance["kinematic"]["wheels"]
    assert "yaw_late@day1" in wheels["standard_errors"]
    assert wheels["of_logs"]["yaw_late@day1"] == pytest.approx(DAYS[1]["yaw_late"], abs=0.02)


def test_a_profile_is_a_prior_that_a_silent_log_does_not_move(
    together: Fitted, tmp_path: Path
) -> None:
    """A straight line tells nothing of turns: their numbers stay within a part of the spread."""
    t = 0.05 * np.arange(800)
    noise = np.random.default_rng(2).normal(0.0, (0.005, 0.005, 0.003), (800, 3))
    x, y, yaw = np.outer((0.93 * 0.4, 0.0, 0.0), t) + noise.T
    wheels = np.full(800, 0.4 / together.plant.vehicle.wheel_radius)
    rows = np.column_stack([t, x, y, yaw, wheels, wheels])
    path = tmp_path / "straight.csv"
    np.savetxt(path, rows, delimiter=",", header="t,x,y,yaw,enc_left,enc_right", comments="")
    after = fit("kinematic", path, profile=together.profile, input="wheels").plant
    before = together.plant
    for name in ("y_l", "y_r", "drift"):
        moved = getattr(after.parameters, name) - getattr(before.parameters, name)
        assert abs(moved) < 0.7 * before.spread[name], name
    assert after.spread == before.spread


@pytest.mark.usefixtures("one_start")
def test_four_days_tell_how_much_a_body_differs_from_day_to_day(
    logs: list[Path], tmp_path: Path
) -> None:
    wider = {**BODY, **DAYS[3], "y_l": 0.57}
    four = [*logs, drive(tmp_path, "wider", wider, 4)]
    found = fit("kinematic", four, profile=BARE, input="wheels")
    assert found.plant.spread["y_l"] == pytest.approx(0.06, abs=0.025)
    assert found.plant.spread["alpha_l"] < 0.03
    errors = {p.name: p.standard_error for p in found.parameters}
    # the mean of four days is as sure as days are alike
    assert errors["y_l"] > 0.015
    # a band of days left out holds a day between them, which one day's band does not
    new = drive(tmp_path, "new", {**BODY, **DAYS[1], "y_l": 0.51}, 8)
    options: dict[str, Any] = {"plants": ("kinematic",), "input": "wheels", "bands": True}
    alone = fit("kinematic", logs[0], profile=BARE, input="wheels")
    shares = []
    for profile in (found.profile, alone.profile):
        held = compare(new, profile, **options).scores["kinematic"].held
        shares.append([share for parts in held.values() for share, _ in parts.values()])
    assert min(shares[0]) > 0.9
    assert max(shares[1]) < 0.7


def test_a_delay_and_latenesses_are_known_as_sums_alone(tmp_path: Path) -> None:
    """A robot that answers later, and a localiser that is as much earlier, make one log."""
    true = {**BODY, **DAYS[0], "delay": 0.08, "acceleration_v": 2.0, "wheel_lag": 0.05}
    path = drive(tmp_path, "commanded", true, 5, "twist")
    fitted = fit("kinematic", path, profile=BARE, input="commands", search="lsq")
    found = {p.name: p for p in fitted.parameters}
    for name in ("delay", "position_late", "yaw_late"):
        assert found[name].standard_error is not None
        assert found[name].standard_error > 0.1
        assert abs(found[name].value - true[name]) < 2.0 * found[name].standard_error
    (note,) = [each for each in fitted.remarks if each.startswith("Delays are known together")]
    sums = re.findall(r"delay \+ wheel_lag \+ (\w+) = ([\d.]+) ± ([\d.]+) s", note)
    assert [name for name, _, _ in sums] == ["position_late", "yaw_late"]
    for name, value, error in sums:
        off = float(value) - true["delay"] - true["wheel_lag"] - true[name]
        assert abs(off) < 3.0 * float(error) < 0.06


def test_names_of_logs_and_grounds(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "run.csv").touch()
    (tmp_path / "odd@name.csv").touch()
    first = f"{tmp_path}/a/run.csv@grass"
    second = f"{tmp_path}/b/run.csv@tile"
    assert split_ground(first) == (f"{tmp_path}/a/run.csv", "grass")
    assert split_ground(f"{tmp_path}/odd@name.csv") == (f"{tmp_path}/odd@name.csv", "")
    tags = tags_of([first, second], ["new.csv@grass"])
    assert list(tags.values()) == [("run", "grass"), ("run:2", "tile"), ("grass",)]
    names = split_by_log(["friction", "mass", "yaw_late"], ["run", "run:2"], ["grass", "tile"])
    assert own_indices(names, ("run:2", "tile")) == {"friction": [1], "mass": [2], "yaw_late": [4]}
    assert own_indices(names, ("grass",))["yaw_late"] == [3, 4]
    plant = load_profile("thesis-lab").plants["mujoco"]
    values = (0.2, 0.6, plant.parameters.mass, 0.1, 0.3)
    judged = with_values("mujoco", plant, names, values, ("grass",), (1.0, 1.0, 1.0, 3.0, 1.0))
    assert judged.parameters.friction == 0.2
    assert judged.localiser.yaw_late == pytest.approx(0.15)


def test_a_number_of_a_log_that_is_none_is_refused(logs: list[Path]) -> None:
    with pytest.raises(ValueError, match="yaw_late@monday names no log and no ground"):
        fit("kinematic", logs, profile=BARE, input="wheels", fix={"yaw_late@monday": 0.1})


def test_numbers_follow_a_log_while_it_drives(logs: list[Path]) -> None:
    options: dict[str, Any] = {"profile": BARE, "plants": ("kinematic",), "input": "wheels"}
    held = compare(logs[0], **options).scores["kinematic"].overlapping[6.0]
    followed = compare(logs[0], adapt=20.0, bands=True, **options)
    after = followed.scores["kinematic"].overlapping[6.0]
    assert after.n == held.n
    assert after.position_median_m < 0.3 * held.position_median_m
    assert after.yaw_median_rad < 0.3 * held.yaw_median_rad
    first, *_ = followed.runs["kinematic"].motions
    assert np.array_equal(first.t, followed.truth[0].t)
    with pytest.raises(ValueError, match="adapt needs a recording"):
        compare("traj4", adapt=30.0, plants=("kinematic",))


def test_a_prediction_uses_the_past_alone(logs: list[Path], tmp_path: Path) -> None:
    """What the wheels do after 50 s moves nothing before."""
    rows = np.loadtxt(logs[0], delimiter=",", skiprows=1)
    header = logs[0].read_text().splitlines()[0]
    names = header.split(",")
    rows[rows[:, 0] > 50.0, names.index("enc_left")] *= 1.3
    other = tmp_path / "other.csv"
    np.savetxt(other, rows, delimiter=",", header=header, comments="", fmt="%.17g")
    plant = BARE.plants["kinematic"]
    both = []
    for path in (logs[0], other):
        source = open_source(str(path), "wheels")
        _, motions, *_ = adapted_along("kinematic", plant, source, "wheels", 20.0)
        both.append(motions)
    early = [motion.t <= 49.9 for motion in both[0][:3]]
    for mine, theirs, before in zip(*both, early, strict=False):
        assert np.allclose(mine.pose[before], theirs.pose[before], atol=1e-9)
    later = both[0][3].pose - both[1][3].pose
    assert np.abs(later[early[0]]).max() > 1e-3


def test_numbers_follow_samples_as_they_come(logs: list[Path]) -> None:
    """A robot that stands first tells nothing; then its numbers come back from half a minute."""
    rows = np.loadtxt(logs[0], delimiter=",", skiprows=1)
    names = logs[0].read_text().splitlines()[0].split(",")
    table = rows[:, [names.index(name) for name in ("t", "enc_left", "enc_right")]]
    poses = rows[:, [names.index(name) for name in ("x", "y", "yaw")]]
    before = BARE.plants["kinematic"]
    following = Calibrating("kinematic", before, seconds=20.0, memory=60.0)
    changed = [following.add(t, (0.0, 0.0), poses[0]) for t in np.arange(0.0, 20.1, 0.05)]
    assert not any(changed)
    assert following.plant is before
    changed = []
    for (t, *rates), pose in zip(table, poses, strict=True):
        changed.append(following.add(t + 20.1, rates, pose))
    assert sum(changed) == 3
    numbers = following.plant.parameters
    assert numbers.alpha_l == pytest.approx(BODY["alpha_l"], abs=0.005)
    assert numbers.y_r == pytest.approx(BODY["y_r"], abs=0.02)


@pytest.mark.usefixtures("one_start")
def test_a_bound_that_is_hit_is_moved_and_named(tmp_path: Path) -> None:
    """A localiser that is 1.3 s late lies beyond the usual bounds, of 1 s."""
    late = drive(tmp_path, "late", {**BODY, "position_late": 1.3, "yaw_late": 1.3}, 5)
    options: dict[str, Any] = {"profile": BARE, "plants": ("kinematic",), "trust": True}
    report = calibrate(late, **options)
    found = {p.name: p.value for p in report.fits[0].parameters}
    assert found["position_late"] == pytest.approx(1.3, abs=0.02)
    assert found["yaw_late"] == pytest.approx(1.3, abs=0.02)
    assert any("hit a bound, which was moved, and" in note for note in report.notes())
