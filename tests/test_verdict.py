"""How calibrations divide logs, judge fits, and go on without columns that they do not need."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.test_several_logs import BARE, BODY, DAYS, drive
from validation.calibrate import calibrate
from validation.compare import compare
from validation.experiment.sources import Source
from validation.files.inspection import open_log
from validation.fit import fit
from validation.identify.uncertainty import usual_spread
from validation.identify.verdict import divide_logs, is_better
from validation.plants.searchable import make_space

pytestmark = pytest.mark.usefixtures("one_start")

OPTIONS: dict[str, Any] = {"profile": BARE, "plants": ("kinematic",)}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A day of a body, with 5 mm and 3 mrad of noise."""
    return drive(tmp_path_factory.mktemp("one"), "day0", {**BODY, **DAYS[0]}, 0)


def columns_of(path: Path) -> tuple[list[str], np.ndarray[Any, Any]]:
    names = path.read_text().splitlines()[0].split(",")
    return names, np.loadtxt(path, delimiter=",", skiprows=1)


def write_rows(path: Path, names: list[str], rows: np.ndarray[Any, Any]) -> Path:
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="", fmt="%.12g")
    return path


def seconds_in_motion(sources: list[Source]) -> float:
    pieces = [piece for source in sources for piece in source.pieces]
    return sum(0.05 * int(np.sum(piece.moves)) for piece in pieces if piece.moves is not None)


def test_a_log_is_divided_by_its_time_in_motion(log: Path, tmp_path: Path) -> None:
    """Three minutes at rest before the drive move no cut: each part judges as much motion."""
    names, rows = columns_of(log)
    still = np.repeat(rows[:1], 3600, axis=0)
    still[:, names.index("t")] = 0.05 * np.arange(3600)
    wheels = [names.index(name) for name in ("enc_left", "enc_right")]
    still[:, wheels] = 0.0
    still[:, 3:] += np.random.default_rng(0).normal(0.0, 0.003, still[:, 3:].shape)
    rows[:, names.index("t")] += 180.0
    path = write_rows(tmp_path / "rest.csv", names, np.concatenate([still, rows]))
    folds = divide_logs({str(path): open_log(path)}, {}, "wheels")
    *judged, (whole, none) = folds
    assert none == ()
    total = seconds_in_motion(whole)
    for train, judges in judged:
        assert seconds_in_motion(list(judges)) == pytest.approx(total / 3.0, abs=0.3)
        assert seconds_in_motion(train) == pytest.approx(2.0 * total / 3.0, abs=0.3)


def test_what_is_written_has_seen_all_and_what_judges_has_been_seen_by_no_judged_fit(
    log: Path,
) -> None:
    report = calibrate(log, **OPTIONS)
    whole = fit("kinematic", log, profile=BARE, input="wheels")
    assert report.fits[0].plant.parameters == whole.plant.parameters
    assert report.document()["written_from"] == "all"
    # thirds judge all of the log, by errors that are larger than those of the fit itself
    judged = report.fits[0].judged["after"].overlapping[6.0]
    seen = whole.together.overlapping[6.0]
    assert seen.n - 2 * 6 <= judged.n < seen.n
    assert judged.position_median_m > seen.position_median_m


def test_each_of_several_logs_judges_a_fit_to_the_others(log: Path, tmp_path: Path) -> None:
    """A day of a wider body errs by the fit to the others, and says nothing of the rest."""
    wider = drive(tmp_path, "day1", {**BODY, **DAYS[0], "y_l": 0.6}, 1)
    report = calibrate([log, wider], **OPTIONS)
    after = report.fits[0].held_out
    assert {Path(name).stem for name in after} == {"day0", "day1"}
    alone = fit("kinematic", log, profile=BARE, input="wheels", held_out=(str(wider),))
    (scores,) = alone.held_out.values()
    assert after[str(wider)].overlapping == scores.overlapping


def test_better_is_more_than_chance_and_more_than_two_percent() -> None:
    rng = np.random.default_rng(1)
    was = 0.1 + 0.02 * rng.standard_normal(120)
    noise = 0.02 * rng.standard_normal(120)
    assert not is_better(was, was, 6.0)
    assert not is_better(0.99 * was, was, 6.0)
    assert is_better(0.9 * was, was, 6.0)
    # by chance, one of two equals is often better by more than 2 %
    called = [is_better(np.roll(noise, k) + 0.1, was, 6.0) for k in range(0, 120, 3)]
    assert np.mean(called) < 0.2
    # three windows side by side tell nothing from chance
    assert not is_better(0.5 * was[:18], was[:18], 6.0)


def test_a_fit_that_explains_no_motion_is_not_better(log: Path, tmp_path: Path) -> None:
    """Wheels of another drive explain no turn, however little the error falls."""
    names, rows = columns_of(log)
    for name in ("enc_left", "enc_right"):
        k = names.index(name)
        rows[:, k] = rows[::-1, k]
    path = write_rows(tmp_path / "unrelated.csv", names, rows)
    report = calibrate(path, trust=True, **OPTIONS)
    assert report.fits[0].better is False
    assert "do not explain the motion" in report.fits[0].worse[0]


@pytest.mark.parametrize("factor", [-1.0, 1.3])
def test_a_gyro_that_contradicts_the_log_is_said_and_left_out(
    log: Path, tmp_path: Path, factor: float
) -> None:
    names, rows = columns_of(log)
    heading = np.unwrap(rows[:, names.index("yaw")])
    rate = np.gradient(heading, 0.05)
    smooth = np.convolve(rate, np.ones(7) / 7.0, mode="same")
    table = np.column_stack([rows, factor * smooth])
    path = write_rows(tmp_path / "gyro.csv", [*names, "gyro_z"], table)
    report = calibrate(path, **OPTIONS)
    assert any("gyro_z" in fault.columns for fault in report.faults)
    assert any("The gyro is left out" in note for note in report.notes())
    plain = calibrate(log, **OPTIONS)
    found = [report.fits[0].parameters, plain.fits[0].parameters]
    values = [[p.value for p in parameters] for parameters in found]
    # the file has twelve digits
    assert values[0] == pytest.approx(values[1], abs=1e-9)


def test_a_tyre_that_lost_air_is_named_and_the_others_are_not(tmp_path: Path) -> None:
    """The left wheels of the third day roll 3 % shorter; nothing else has changed."""
    days = [drive(tmp_path, f"day{k}", {**BODY, **DAYS[k]}, k) for k in range(2)]
    flat = {**BODY, **DAYS[2], "alpha_l": 0.97 * BODY["alpha_l"]}
    report = calibrate([*days, drive(tmp_path, "day2", flat, 2)], **OPTIONS)
    rows = report.document()["days"]
    assert [row["log"] for row in rows] == ["day0.csv", "day1.csv", "day2.csv"]
    radius = BARE.robot.wheel_radius
    for row, alpha in zip(rows, (0.95, 0.95, 0.97 * 0.95), strict=True):
        error = row["standard_errors"]["wheel_radius_left"]
        assert row["wheel_radius_left"] == pytest.approx(alpha * radius, abs=3.0 * error)
        assert error < 0.003 * radius
    said = [note for note in report.notes() if note.startswith("On day")]
    assert said
    assert all(note.startswith("On day2.csv the ") for note in said)
    (left,) = [note for note in said if "the left wheels roll" in note]
    assert 2.0 < float(left.partition("roll ")[2].split()[0]) < 4.0
    assert "shorter than on day0.csv" in left
    assert not any("the right wheels roll" in note for note in said)
    assert any(table.title.startswith("Tyres by each log") for table in report.tables())


def test_the_band_of_one_day_holds_days_that_differ_as_days_do(log: Path, tmp_path: Path) -> None:
    """Every number lies one usual spread off; a band of the day alone holds few headings then."""
    profile = calibrate(log, **OPTIONS).profile
    space = make_space("kinematic", list(BODY), {}, BARE.robot)
    signs = np.random.default_rng(5).choice((-1.0, 1.0), len(space))
    off = {}
    for p, sign in zip(space.parameters, signs, strict=True):
        off[p.name] = BODY[p.name] + sign * usual_spread(p.name) * (p.upper - p.lower)
    other = drive(tmp_path, "other", {**off, **DAYS[0]}, 6)
    options: dict[str, Any] = {"plants": ("kinematic",), "input": "wheels", "bands": True}
    held = compare(other, profile, **options).scores["kinematic"].held
    shares = [share for parts in held.values() for share, _ in parts.values()]
    # a day on which all is off by a whole spread is worse than most
    assert min(shares) > 0.6
    assert np.mean(shares) > 0.8
    # the same day is inside more often than promised
    again = compare(log, profile, **options).scores["kinematic"].held
    assert min(share for parts in again.values() for share, _ in parts.values()) > 0.9
