"""A log is a value: a program opens it once, looks at it once, and hands it on."""

from __future__ import annotations

import os
import pickle
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

from tests.test_several_logs import BARE, BODY, DAYS, drive
from validation.calibrate import calibrate
from validation.compare import compare
from validation.experiment.sources import open_source
from validation.files import inspection
from validation.files.formats import read_log
from validation.files.inspection import Inspected
from validation.files.log import Group, Log
from validation.fit import fit
from validation.recordings import info


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two days of one body."""
    folder = tmp_path_factory.mktemp("once")
    return [drive(folder, f"once{k}", {**BODY, **DAYS[k]}, k) for k in range(2)]


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Count how often each log is opened, and how often it is looked at for faults and delays."""
    counts = Counter[str]()
    open_file = os.open

    def count_opening(path: Any, *args: Any, **kwargs: Any) -> int:
        name = Path(os.fsdecode(path)).name
        counts[name] += name.startswith("once")
        return open_file(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", count_opening)
    for name in ("judged", "estimate_offsets", "find_rest"):
        look = getattr(inspection, name)

        def count_look(signals: Any, look: Any = look, name: str = name) -> Any:
            counts[name] += 1
            return look(signals)

        monkeypatch.setattr(inspection, name, count_look)
    return counts


def opened(counts: Counter[str]) -> dict[str, int]:
    return {name: many for name, many in counts.items() if name.startswith("once") and many}


@pytest.mark.usefixtures("one_start")
def test_calibrate_opens_each_log_once_and_looks_at_it_once(
    paths: list[Path], counted: Counter[str]
) -> None:
    calibrate(paths, profile=BARE, plants=("kinematic",), trust=True)
    assert opened(counted) == {path.name: 1 for path in paths}
    assert counted["judged"] == 2
    assert counted["estimate_offsets"] <= 2
    assert counted["find_rest"] <= 2


def test_a_log_that_is_held_out_is_opened_once(paths: list[Path], counted: Counter[str]) -> None:
    first, second = paths
    calibrate(first, profile=BARE, plants=("kinematic",), held_out=second, trust=True)
    assert opened(counted) == {first.name: 1, second.name: 1}
    counted.clear()
    options: dict[str, Any] = {"profile": BARE, "input": "wheels", "search": "lsq"}
    fit("kinematic", first, until=40.0, held_out=(str(first), str(second)), **options)
    assert opened(counted) == {first.name: 1, second.name: 1}
    assert counted["judged"] == 2


@pytest.mark.usefixtures("one_start")
def test_programs_take_a_log_by_its_path_or_itself(paths: list[Path]) -> None:
    log = read_log(paths[0])
    options: dict[str, Any] = {"profile": BARE, "input": "wheels"}
    by_path = compare(paths[0], plants=("kinematic",), **options)
    for given in (log, open_source(log, "wheels")):
        by_value = compare(given, plants=("kinematic",), **options)
        assert by_value.scores["kinematic"].as_dict() == by_path.scores["kinematic"].as_dict()
    fitted = fit("kinematic", paths, search="lsq", **options)
    values = fit("kinematic", list(map(read_log, paths)), search="lsq", **options)
    assert values.plant.parameters == fitted.plant.parameters
    sources = [open_source(path, "wheels") for path in paths]
    assert fit("kinematic", sources, search="lsq", **options).plant.parameters == (
        fitted.plant.parameters
    )
    frame = pandas.read_csv(paths[0])
    framed = fit("kinematic", frame, search="lsq", **options)
    alone = fit("kinematic", log, search="lsq", **options)
    assert framed.plant.parameters == alone.plant.parameters
    assert info(log).document() == info(paths[0]).document()
    judged: dict[str, Any] = {"profile": BARE, "held_out": paths[1], "trust": True}
    calibrated = calibrate(log, plants=("kinematic",), **judged)
    again = calibrate(paths[0], plants=("kinematic",), **judged)
    assert calibrated.document() == again.document()


def test_a_part_of_a_log_is_looked_at_as_the_whole(paths: list[Path]) -> None:
    """A part of a log shows the clocks and jumps that the whole log shows in it."""
    whole = open_source(paths[0], "wheels")
    part = open_source(paths[0], "wheels", 20.0, 50.0)
    assert whole.inspected is not None
    assert part.inspected is not None
    assert part.inspected.offsets == whole.inspected.offsets
    (piece,) = part.pieces
    assert piece.t is not None
    assert (piece.t[0], piece.t[-1]) == pytest.approx((20.0, 50.0))


def test_jumps_between_stamps_of_their_own_split_windows_on_the_common_clock(
    paths: list[Path],
) -> None:
    """A pose that is made of those before and after a jump is nowhere, and no window ends there."""
    log = read_log(paths[0])
    pose = log.groups["pose"]
    moved = {**pose.columns, "x": pose.columns["x"] + 3.0 * (pose.t >= 30.0)}
    rare = {name: values[::4] for name, values in moved.items()}
    # the common clock begins with the wheels, between two poses
    wheels = log.groups["wheels"].where(pose.t >= 0.1)
    slow = Log(log.path, {"wheels": wheels, "pose": Group("pose", pose.t[::4], rare)})
    (piece,) = open_source(slow, "wheels").pieces
    assert piece.t is not None
    assert piece.fresh is not None
    assert piece.reference is not None
    (first,) = piece.jumps
    steps = np.abs(np.diff(piece.reference.pose[:, 0])) > 1.0
    assert np.flatnonzero(steps).tolist() == [first - 2, first - 1]
    assert piece.t[first] == pytest.approx(30.1)
    assert not piece.fresh[first - 1]
    assert piece.fresh[[first - 2, first]].all()


def test_a_log_cannot_be_changed_and_can_be_sent(paths: list[Path]) -> None:
    given = np.arange(100.0)
    log = Log.of_columns("log.csv", {"t": given, "x": given, "y": given, "yaw": 0.0 * given})
    given[:] = 7.0
    assert log.groups["pose"].columns["x"][3] == 3.0
    parts = (read_log(paths[0]), log, log.cut(3.0, 50.0), log.on_one_clock(20.0))
    for each in parts:
        for group in each.groups.values():
            with pytest.raises(ValueError, match="read-only"):
                group.t[0] = 1.0
            for values in group.columns.values():
                with pytest.raises(ValueError, match="read-only"):
                    values[0] = 1.0
            with pytest.raises(TypeError):
                group.columns["x"] = given  # type: ignore[index]
        with pytest.raises(TypeError):
            each.groups["pose"] = log.groups["pose"]  # type: ignore[index]
        sent = pickle.loads(pickle.dumps(each))  # noqa: S301 # our own
        assert np.array_equal(sent.table(("x", "y")), each.table(("x", "y")))
    assert Inspected(log).faults == Inspected(log).faults
