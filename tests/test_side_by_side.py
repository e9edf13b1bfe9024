"""Results of several runs in one table, and a run that is repeated by its file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from validation.cli import __main__ as ssmr
from validation.cli.config import config_of, options_from
from validation.compare import Compare, compare
from validation.files.limits import USUAL
from validation.fit import fit
from validation.plants.profile import load_profile
from validation.table import table

PLANTS = ("improved", "linear")


def called(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """Run the command `ssmr` and return its exit status."""
    monkeypatch.setattr(sys, "argv", ["ssmr", *arguments])
    try:
        ssmr.main()
    except SystemExit as left:
        return int(left.code or 0)
    return 0


def results(folder: Path) -> dict[str, Any]:
    """Return what a comparison measured, without what depends on the clock."""
    document = json.loads((folder / "compare.json").read_text())
    timed = ("wall_s", "cpu_s", "real_time_factor")
    return {
        plant: {key: value for key, value in values.items() if key not in timed}
        for plant, values in document["plants"].items()
    }


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The JSON file of a comparison."""
    folder = tmp_path_factory.mktemp("run")
    compare("traj4", plants=PLANTS, reference="linear", noise=True, seed=3).save(
        folder, recording=False
    )
    return folder / "compare.json"


def test_a_run_is_repeated_by_its_file(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    again = ["compare", "--config", str(run), "--no-rerun", "--out"]
    assert called([*again, str(tmp_path / "a")], monkeypatch) == 0
    assert results(tmp_path / "a") == results(run.parent)
    # the command line comes before the file, its place included
    assert called([*again, str(tmp_path / "b"), "--seed=4"], monkeypatch) == 0
    assert results(tmp_path / "b") != results(run.parent)
    assert called([*again, str(tmp_path / "c"), "traj2", "--plants", "linear"], monkeypatch) == 0
    document = json.loads((tmp_path / "c" / "compare.json").read_text())
    assert (document["source"], list(document["plants"])) == ("traj2", ["linear"])
    assert (document["config"]["seed"], document["config"]["noise"]) == (3, True)
    assert compare(config=run).as_dict()["plants"].keys() == results(run.parent).keys()
    assert compare("traj2", config=run, plants=("linear",)).seed == 3


def test_options_of_every_kind_come_back(tmp_path: Path) -> None:
    given = {
        "columns": {"x": ("px", ""), "yaw": ("heading", "deg")},
        "topics": {"pose": "/p"},
        "limits": USUAL.changed({"gap": 1e4}),
        "terrain": "ramp:5",
        "horizons": (2.0, 6.0),
        "since": 1.5,
    }
    wanted = Compare("x.csv", **given)
    path = tmp_path / "x.json"
    document = {"schema": "ssmr.compare/1", "config": config_of("compare", wanted)}
    path.write_text(json.dumps(document))
    assert options_from(path, "compare", Compare) == wanted


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"nope": 1}, "compare has no option 'nope'; there are: "),
        ({"program": "fit"}, "it has the options of fit, wanted those of compare"),
        ({"plants": 3}, "plants is 3, wanted"),
        ({"profile": "an object of Python"}, "profile was an object of Python"),
        ({"source": None}, "source"),
    ],
)
def test_a_file_of_other_options_is_refused(
    change: dict[str, Any],
    message: str,
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    document = json.loads(run.read_text())
    document["config"] |= change
    path = tmp_path / "other.json"
    path.write_text(json.dumps(document))
    out = tmp_path / "out"
    assert called(["compare", "--config", str(path), "--out", str(out)], monkeypatch) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.startswith(f"error: {path}: ")
    assert len(said.splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"schema": "other/1"}', "[" * 100_000])
def test_what_is_no_result_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    for call in (lambda: table((path,)), lambda: compare(config=path)):
        with pytest.raises(ValueError, match=r"x\.json: the file is no "):
            call()


def test_a_run_with_an_object_of_python_names_it(tmp_path: Path) -> None:
    profile = load_profile("thesis-lab")
    compare("traj4", profile, plants=PLANTS).save(tmp_path, recording=False)
    with pytest.raises(ValueError, match="profile was an object of Python"):
        compare(config=tmp_path / "compare.json")


def test_rows_are_those_of_runs_and_plants(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    compare("traj2", plants=PLANTS).save(other, recording=False)
    fit("linear", to="traj4@improved", generations=1, population=8).save(tmp_path / "fit")
    files = (run, other / "compare.json", tmp_path / "fit" / "fit.json")
    whole = table(files)
    (shown,) = whole.tables()
    assert [row["plant"] for row in shown.rows].count("linear") == 2
    assert len({row["run"] for row in shown.rows}) == 3
    assert shown.rows[-1]["model"] == "linear"
    assert shown.rows[-1]["cost"] > 0.0
    # parameters are shown where all runs fitted them
    assert "parameters.gain.value" not in shown.rows[-1]
    assert table(files[-1:]).tables()[0].rows[0]["parameters.gain.value"] > 0.0
    measured = results(run.parent)
    assert [row["d_rms_m"] for row in shown.rows if row["run"] == shown.rows[0]["run"]] == [
        measured[name]["d_rms_m"] for name in measured
    ]
    chosen = table(files, columns=("sync_rms_m", "d_rms_symmetric_m"))
    assert list(chosen.frame().columns) == ["run", "plant", "sync_rms_m", "d_rms_symmetric_m"]
    chosen.save(tmp_path / "table")
    first, second, *_ = (tmp_path / "table" / "table.csv").read_text().splitlines()
    assert first == "run,plant,sync_rms_m,d_rms_symmetric_m"
    assert float(second.split(",")[2]) == pytest.approx(measured[PLANTS[0]]["sync_rms_m"])
    assert "| sync rms [mm] |" in (tmp_path / "table" / "table.md").read_text()
    panels = chosen.figure().axes
    assert panels[0].get_title(loc="left") == "sync rms [mm]"
    for ax, name in zip(panels, ("sync_rms_m", "d_rms_symmetric_m"), strict=True):
        drawn = [bar.get_width() for bar in ax.patches]
        assert drawn == pytest.approx(
            [1e3 * (row[name] or 0.0) for row in chosen.tables()[0].rows], abs=0.06
        )
    assert (tmp_path / "table" / "table.png").stat().st_size > 1000
    assert not table(files, columns=("source",)).figure().axes
    with pytest.raises(ValueError, match="no result has a 'nope'; there are: run, "):
        table(files, columns=("nope",))
    with pytest.raises(ValueError, match="'value' may be parameters"):
        table(files, columns=("value",))
    with pytest.raises(ValueError, match="different files"):
        table((run, run))
