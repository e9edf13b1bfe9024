"""The fit program: recovery, resumption, interruption, held-out sources; and what it writes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.errors import DivergedError
from tests.conftest import Launch, exit_status
from tests.test_objective import recorded
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.fit import fit
from validation.identify import judging
from validation.identify.problem import FROM_FILE
from validation.identify.uncertainty import VAGUE
from validation.output import Progress
from validation.plants.profile import Profile, load_profile


def document(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "fit.json").read_text()))


def fitted(folder: Path, *arguments: str) -> dict[str, Any]:
    """Return what the program writes in this process."""
    assert exit_status(fit, *arguments, "--out", str(folder)) == 0
    return document(folder)


def test_known_parameters_come_back(tmp_path: Path) -> None:
    measured = fitted(
        tmp_path,
        "coulomb",
        "--to",
        "traj4@coulomb",
        "--free",
        "u_x,mu_c,gain",
        "--seed",
        "1",
    )
    truth = load_profile("thesis-lab").plants["coulomb"].parameters
    assert measured["status"] == "finished"
    assert measured["train"]["sync_rms_m"] < 1e-3
    for name, p in measured["parameters"].items():
        assert p["value"] == pytest.approx(getattr(truth, name), rel=0.02)
        assert p["lower"] < p["value"] < p["upper"]
        assert not p["at_bound"]


def test_ctrl_c_leaves_a_result(lab: Profile) -> None:
    def stop(progress: Progress) -> None:
        if progress.done == 2.0:
            raise KeyboardInterrupt

    result = fit(
        "kinematic",
        "traj4@kinematic",
        lab,
        free=("alpha_l",),
        population=8,
        generations=9,
        progress=stop,
    )
    assert (result.status, result.document()["stopped_by"], result.document()["generations"]) == (
        "interrupted",
        "interrupt",
        0,
    )
    assert result.correlation is None


def test_a_log_is_fitted_by_its_wheels_and_judged_on_what_was_cut_off(tmp_path: Path) -> None:
    log = tmp_path / "drive.csv"
    out = tmp_path / "out"
    write_csv(recorded(load_profile("thesis-lab"), "kinematic", 40.0), log)
    args = [
        "kinematic",
        "--to",
        str(log),
        "--until",
        "25",
        "--held-out",
        str(log),
        "--input",
        "wheels",
        "--horizons",
        "2",
    ]
    free = [
        "--free",
        "y_l,y_r,alpha_l",
        "--profile",
        "thesis-lab",
        "--generations",
        "40",
        "--population",
        "24",
    ]
    measured = fitted(out, *args, *free)
    assert set(measured["train_by_source"]) == set(measured["held_out"]) == {str(log)}
    train, test = (
        measured[part][str(log)]["horizons"]["2"] for part in ("train_by_source", "held_out")
    )
    assert max(train["position_median_m"], test["position_median_m"]) < 0.01
    assert train["n"] > test["n"]
    assert measured["parameters"]["y_l"]["value"] == pytest.approx(0.275, abs=0.01)
    again = load_profile(str(out / "profile.toml"))
    assert again.plants["kinematic"].parameters.y_l == measured["parameters"]["y_l"]["value"]
    assert again.plants["mujoco"] == load_profile("thesis-lab").plants["mujoco"]
    provenance = again.provenance["kinematic"]["wheels"]
    assert (provenance["seed"], provenance["cost"]) == (0, measured["cost"])
    assert set(provenance["standard_errors"]) == {"y_l", "y_r", "alpha_l"}


def test_turns_are_fitted_to_the_gyro_where_it_is_the_better_judge(
    tmp_path: Path, lab: Profile
) -> None:
    """A localiser that misses a tenth of every turn; a gyro with the wrong sign and a bias."""
    log = recorded(lab, "kinematic", 60.0)
    apart = []
    yaw = log.columns["yaw"]
    gyro = {"gyro_z": 0.02 - np.gradient(yaw, log.t)}
    for name, more in (("bare", {}), ("gyro", gyro)):
        write_csv(
            Log.of_columns("a.csv", {"t": log.t, **log.columns, **more, "yaw": 0.9 * yaw}),
            tmp_path / f"{name}.csv",
        )
        options = {
            "profile": lab,
            "input": "wheels",
            "position_weight": 0.0,
            "free": ("y_l", "y_r"),
            "search": "lsq",
        }
        found = fit(
            "kinematic",
            str(tmp_path / f"{name}.csv"),
            horizons=(2.0,),
            out=tmp_path / name,
            **options,
        )
        # the judge of the fit is that of its scores: the other would find a tenth of turns amiss
        assert found.together.overlapping[2.0].yaw_median_rad < 0.03
        y_l, y_r = (p.value for p in found.parameters)
        apart.append(y_l - y_r)
        assert any("headings are scored against the gyro" in note for note in found.notes()) == (
            name == "gyro"
        )
    assert apart[0] == pytest.approx(0.55 / 0.9, rel=0.01)
    # where a robot never stands, turns to one side count as bias
    assert apart[1] == pytest.approx(0.55, rel=0.02)


def test_what_a_log_hardly_excites_stays_where_it_was(tmp_path: Path) -> None:
    """A noisy straight line says how far wheels roll, and nothing of turns.

    They must not follow the noise.
    """
    t = 0.05 * np.arange(1600)
    noise = np.random.default_rng(2).normal(0.0, 1.0, (1600, 3)) * (0.02, 0.02, 0.01)
    x, y, yaw = (np.outer((0.45, 0.0, 0.0), t).T + noise).T
    wheels = np.full(1600, 0.5 / 0.1651)
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "enc_left": wheels, "enc_right": wheels}
    write_csv(Log.of_columns("a.csv", columns), tmp_path / "a.csv")
    args = [
        "kinematic",
        "--to",
        str(tmp_path / "a.csv"),
        "--robot",
        "husky",
        "--input",
        "wheels",
        "--search",
        "lsq",
    ]
    measured = fitted(tmp_path / "out", *args)["parameters"]
    for name in ("y_l", "y_r", "drift", "position_late", "yaw_late"):
        p = measured[name]
        assert abs(p["value"] - p["before"]) < 0.05 * (p["upper"] - p["lower"]), name
        assert p["standard_error"] > VAGUE * FROM_FILE * (p["upper"] - p["lower"]), name
    assert 0.5 * (measured["alpha_l"]["value"] + measured["alpha_r"]["value"]) == pytest.approx(
        0.9, abs=0.01
    )


def test_a_fit_that_is_worse_on_held_out_data_keeps_the_old_numbers(tmp_path: Path) -> None:
    log = tmp_path / "lab.csv"
    lab = load_profile("thesis-lab")
    good = recorded(lab, "kinematic", 20.0)
    write_csv(good, log)
    bad = good.changed("wheels", {"enc_left": 1.2 * good.columns["enc_left"]})
    write_csv(bad, tmp_path / "bad.csv")
    args = [
        "kinematic",
        "--to",
        str(tmp_path / "bad.csv"),
        "--held-out",
        str(log),
        "--input",
        "wheels",
        "--search",
        "lsq",
    ]
    options = [*args, "--profile", "thesis-lab", "--free", "alpha_l,alpha_r", "--horizons", "2"]
    measured = fitted(tmp_path / "kept", *options)
    assert measured["better"] is False
    assert "no better on held-out data" in measured["notes"][0]
    assert (
        load_profile(tmp_path / "kept" / "profile.toml").plants["kinematic"]
        == lab.plants["kinematic"]
    )
    fitted(tmp_path / "forced", *options, "--even-if-worse")
    forced = load_profile(tmp_path / "forced" / "profile.toml").plants["kinematic"].parameters
    assert (
        forced.alpha_l
        == measured["parameters"]["alpha_l"]["value"]
        != lab.plants["kinematic"].parameters.alpha_l
    )


def test_what_the_data_cannot_tell_is_said(tmp_path: Path) -> None:
    """Two numbers of which only the quotient matters, and one that does nothing here."""
    args = [
        "kinematic",
        "--to",
        "traj4@kinematic",
        "--free",
        "wheel_radius,alpha_l,alpha_r,acceleration_w",
    ]
    measured = fitted(
        tmp_path, *args, "--bounds", "acceleration_w=5:20,alpha_l=0.8:1.1,alpha_r=0.8:1.1"
    )
    reported = " ".join(measured["notes"])
    assert "cannot tell" in reported
    assert "wheel_radius" in reported
    assert "hardly determine acceleration_w" in reported
    p = measured["parameters"]["acceleration_w"]
    assert p["standard_error"] > VAGUE * FROM_FILE * (p["upper"] - p["lower"])


def test_a_bound_that_was_reached_is_flagged(tmp_path: Path) -> None:
    args = [
        "kinematic",
        "--to",
        "traj4@kinematic",
        "--free",
        "alpha_l,alpha_r",
        "--bounds",
        "alpha_l=0.8:0.9",
    ]
    measured = fitted(tmp_path, *args, "--population", "16", "--generations", "40")
    assert measured["parameters"]["alpha_l"]["at_bound"]
    assert not measured["parameters"]["alpha_r"]["at_bound"]
    assert any("alpha_l ended at its upper bound, 0.9" in note for note in measured["notes"])


LONG = "improved --to traj4@coulomb --seed 3 --generations 12 --population 20 --patience 99".split()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The end of a fit that nobody breaks off."""
    return fitted(tmp_path_factory.mktemp("through"), *LONG)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_broken_off_fit_resumes_to_the_same_end(
    how: signal.Signals, whole: dict[str, Any], tmp_path: Path, launch: Launch
) -> None:
    broken = tmp_path / "broken"
    command = [sys.executable, "-m", "validation.fit", *LONG, "--out", str(broken)]
    child = launch(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120.0
    while (
        not (broken / "checkpoint.npz").exists()
        and time.monotonic() < deadline
        and child.poll() is None
    ):
        time.sleep(0.01)
    child.send_signal(how)
    said, errors = child.communicate(timeout=60)
    if how == signal.SIGINT and child.returncode != 0:  # 0: it was done before the signal came
        assert child.returncode == 130, errors
        assert "the same command with --resume goes on from there" in " ".join(said.split())
        stopped = document(broken)
        assert stopped["status"] == "interrupted"
        assert stopped["parameters"]["gain"]["standard_error"] is None
        assert (
            load_profile(str(broken / "profile.toml")).provenance["improved"]["scenario"]["status"]
            == "interrupted"
        )
    resumed = fitted(broken, *LONG, "--resume")
    for key in ("parameters", "cost", "evaluations", "generations"):
        assert resumed[key] == whole[key], key


def test_a_checkpoint_of_another_fit_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = [
        "kinematic",
        "--to",
        "traj4@kinematic",
        "--free",
        "alpha_l",
        "--out",
        str(tmp_path),
        "--population",
        "8",
    ]
    assert exit_status(fit, *args, "--generations", "2") == 0
    for change, what in (
        (["--seed", "4"], "seed"),
        (["--bounds", "alpha_l=0.9:1.1"], "parameters or bounds"),
        (["--objective", "sync"], "objective"),
        (["--search", "hybrid"], "search"),
        (["--generations", "3"], "settings of the search"),
    ):
        settings = [] if "--generations" in change else ["--generations", "2"]
        capsys.readouterr()
        assert exit_status(fit, *args, *settings, *change, "--resume") == 2
        reported = capsys.readouterr().err.strip()
        assert f"checkpoint of another search: it differs in {what};" in reported
        assert "\n" not in reported


def test_a_fit_is_kept_whose_errors_or_scores_cannot_be_had(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options: dict[str, Any] = {"free": ("alpha_l",), "population": 8, "generations": 2}
    whole = fit("kinematic", "traj4@kinematic", **options)
    program = sys.modules["validation.fit"]
    real = judging.drive_source

    def fail(*_: Any) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    def diverge(plant: Any, source: Any, localiser: Any) -> Any:
        if source.name == "traj1":
            raise DivergedError("it left the finite numbers")
        return real(plant, source, localiser)

    monkeypatch.setattr(program, "estimate_uncertainty", fail)
    monkeypatch.setattr(judging, "drive_source", diverge)
    result = fit("kinematic", "traj4@kinematic", held_out=("traj1",), **options)
    assert (result.cost, result.parameters[0].standard_error, result.held_out) == (
        whole.cost,
        None,
        {},
    )
    assert (
        "How sure numbers and predictions are could not be estimated: Singular matrix."
        in result.notes()
    )
    assert any(
        "cannot be driven along traj1, which was held out" in note for note in result.notes()
    )
