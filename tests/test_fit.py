"""The fit program: recovery, resumption, interruption, held-out sources, mistakes; and what it writes."""

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
from ssmr.scenarios import TRAJECTORIES
from ssmr.search.jde import Jde, JdeSettings
from tests.conftest import EXACT, Launch, exit_status
from tests.robots import HUSKY
from tests.test_objective import recorded, scenario
from validation.files.csv_logs import write_csv
from validation.fit import __main__ as fit
from validation.fit import run as fit_run
from validation.fit.objective import FitCost
from validation.fit.problem import FitProblem
from validation.fit.run import fit as fit_plant
from validation.fit.search import CheckpointError, Search, SearchOptions, search_for
from validation.fit.uncertainty import VAGUE
from validation.plants.profile import Profile, load_profile
from validation.plants.searchable import make_space
from validation.progress import Progress

QUICK = ("--population", "16", "--generations", "12")


def run(*args: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "validation.fit", *args], capture_output=True, text=True, timeout=300)


def call(*args: str) -> int:
    """The program in this process; its exit status."""
    return exit_status(fit.main, *args)


def document(folder: Path) -> dict:  # type: ignore[type-arg]
    return dict(json.loads((folder / "fit.json").read_text()))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "drive.csv"
    write_csv(recorded(load_profile("thesis-lab"), "kinematic", 40.0), path)
    return path


# ------------------------------------------------------------------------------------------------------- outcome


def test_known_parameters_come_back(tmp_path: Path) -> None:
    args = ["--free", "u_x,mu_c,gain", "--seed", "1", *QUICK]
    assert call("coulomb", "--to", "traj4@coulomb", "--out", str(tmp_path), *args) == 0
    found, truth = document(tmp_path), load_profile("thesis-lab").plants["coulomb"].parameters
    assert found["status"] == "finished"
    assert found["train"]["sync_rms_m"] < 1e-3
    for name, p in found["parameters"].items():
        assert p["value"] == pytest.approx(getattr(truth, name), rel=0.02)
        assert p["lower"] < p["value"] < p["upper"]
        assert not p["at_bound"]


def test_ctrl_c_leaves_a_result(lab: Profile) -> None:
    def stop(progress: Progress) -> None:
        if progress.done == 2.0:
            raise KeyboardInterrupt

    found = fit_plant("kinematic", "traj4@kinematic", lab, free=("alpha_l",), population=8, generations=9, progress=stop)
    assert (found.status, found.stopped_by, found.generations) == ("interrupted", "interrupt", 0)
    assert found.correlation is None


def test_a_log_is_fitted_by_both_inputs_and_judged_on_what_was_cut_off(log: Path, tmp_path: Path) -> None:
    args = ["kinematic", "--to", str(log), "--until", "25", "--held-out", str(log), "--input", "both", "--horizons", "2"]
    free = ["--free", "y_l,y_r,alpha_l", "--profile", "thesis-lab", "--generations", "40", "--population", "24"]
    assert call(*args, *free, "--out", str(tmp_path), "--rerun") == 0
    found = document(tmp_path)
    assert set(found["train_by_source"]) == set(found["held_out"]) == {f"{log} (wheels)", f"{log} (commands)"}
    for scores in (*found["train_by_source"].values(), *found["held_out"].values()):
        assert scores["horizons"]["2"]["position_median_m"] < 0.01
    assert (
        found["train_by_source"][f"{log} (wheels)"]["horizons"]["2"]["n"]
        > found["held_out"][f"{log} (wheels)"]["horizons"]["2"]["n"]
    )
    assert found["parameters"]["y_l"]["value"] == pytest.approx(0.275, abs=0.01)
    for name in ("fit.png", "fit.rrd", "profile.toml", "checkpoint.npz"):
        assert (tmp_path / name).stat().st_size > 500
    again = load_profile(str(tmp_path / "profile.toml"))
    assert again.plants["kinematic"].parameters.y_l == found["parameters"]["y_l"]["value"]
    assert again.plants["mujoco"] == load_profile("thesis-lab").plants["mujoco"]
    provenance = again.provenance["kinematic"]
    assert provenance["seed"] == 0
    assert provenance["cost"] == found["cost"]
    assert set(provenance["standard_errors"]) == {"y_l", "y_r", "alpha_l"}


def test_the_result_does_not_depend_on_workers(tmp_path: Path) -> None:
    for workers in ("1", "2"):
        args = ("linear", "--to", "traj2@linear", "--workers", workers, "--out", str(tmp_path / workers), *QUICK)
        assert call(*args) == 0
    one, two = document(tmp_path / "1"), document(tmp_path / "2")
    assert one["parameters"] == two["parameters"]
    assert one["cost"] == two["cost"]


def test_the_search_is_the_same_with_and_without_abandoning(lab: Profile) -> None:
    """Limits save work; they change no cost that is kept."""
    from tests.test_objective import log_target

    space = make_space("linear", ("k_u", "k_y", "gain", "delay"), {}, HUSKY)
    problem = FitProblem("linear", lab.plants["linear"], space, [log_target(lab)], FitCost("horizon"))
    searches = []
    for abandon in (True, False):
        search = Search(Jde(len(space), JdeSettings(12, 10), 3), {})
        search.run(lambda points, limits, _, a=abandon: problem.costs(points, limits if a else None))
        searches.append(search)
    assert np.abs(searches[0].jde.population - searches[1].jde.population).max() == EXACT
    assert np.array_equal(searches[0].jde.costs, searches[1].jde.costs)


# ------------------------------------------------------------------------------------------------------- honesty


def test_what_the_data_cannot_tell_is_said(lab: Profile, tmp_path: Path) -> None:
    """Two numbers of which only the quotient matters, and one that does nothing here."""
    args = ["kinematic", "--to", "traj4@kinematic", "--free", "wheel_radius,alpha_l,alpha_r,acceleration_w", *QUICK]
    assert call(*args, "--out", str(tmp_path), "--bounds", "acceleration_w=5:20") == 0
    found = document(tmp_path)
    told = " ".join(found["notes"])
    assert "cannot tell" in told
    assert "wheel_radius" in told
    assert "hardly determine acceleration_w" in told
    p = found["parameters"]["acceleration_w"]
    assert p["standard_error"] > VAGUE * (p["upper"] - p["lower"]) * 0.5


def test_a_bound_that_was_reached_is_flagged(tmp_path: Path) -> None:
    args = ["kinematic", "--to", "traj4@kinematic", "--free", "alpha_l,alpha_r", "--bounds", "alpha_l=0.8:0.9", *QUICK]
    assert call(*args, "--out", str(tmp_path), "--generations", "40") == 0
    found = document(tmp_path)
    assert found["parameters"]["alpha_l"]["at_bound"]
    assert not found["parameters"]["alpha_r"]["at_bound"]
    assert any("alpha_l ended at its upper bound, 0.9" in note for note in found["notes"])


# ---------------------------------------------------------------------------------------- interruption, resumption


def wait_for(path: Path, child: subprocess.Popen[bytes], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not path.exists() and time.monotonic() < deadline and child.poll() is None:
        time.sleep(0.01)
    assert path.exists()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_broken_off_fit_resumes_to_the_same_end(how: signal.Signals, tmp_path: Path, launch: Launch) -> None:
    args = "improved --to traj4@coulomb --seed 3 --generations 25 --population 30 --patience 99".split()
    through, broken = tmp_path / "through", tmp_path / "broken"
    assert call(*args, "--out", str(through)) == 0
    command = [sys.executable, "-m", "validation.fit", *args, "--out", str(broken)]
    child = launch(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    wait_for(broken / "checkpoint.npz", child)
    child.send_signal(how)
    _, errors = child.communicate(timeout=60)
    if how == signal.SIGINT and child.returncode != 0:  # 0: it was done before the signal came
        assert child.returncode == 130, errors
        stopped = document(broken)
        assert stopped["status"] == "interrupted"
        assert stopped["parameters"]["gain"]["standard_error"] is None
        assert load_profile(str(broken / "profile.toml")).provenance["improved"]["status"] == "interrupted"
    assert call(*args, "--out", str(broken), "--resume") == 0
    a, b = document(through), document(broken)
    assert a["parameters"] == b["parameters"]
    assert (a["cost"], a["evaluations"], a["generations"]) == (b["cost"], b["evaluations"], b["generations"])


def test_a_checkpoint_of_another_fit_is_refused(lab: Profile, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = ["kinematic", "--to", "traj4@kinematic", "--free", "alpha_l", "--out", str(tmp_path), "--population", "8"]
    assert call(*args, "--generations", "2") == 0
    capsys.readouterr()
    for change, what in (
        (["--seed", "4"], "seed"),
        (["--bounds", "alpha_l=0.9:1.1"], "parameters or bounds"),
        (["--objective", "sync"], "objective"),
        (["--generations", "3"], "settings of the search"),
    ):
        settings = [] if "--generations" in change else ["--generations", "2"]
        assert call(*args, *settings, *change, "--resume") == 2
        told = capsys.readouterr().err.strip()
        assert f"checkpoint of another search: it differs in {what};" in told
        assert "\n" not in told
    (tmp_path / "checkpoint.npz").write_bytes(b"PK\x03\x04 rubbish")
    assert call(*args, "--generations", "2", "--resume") == 2
    assert "no checkpoint of a search, or it is damaged" in capsys.readouterr().err


def test_a_checkpoint_holds_the_whole_search(lab: Profile, tmp_path: Path) -> None:
    space = make_space("coulomb", ("u_x", "mu_c"), {}, HUSKY)
    problem = FitProblem("coulomb", lab.plants["coulomb"], space, [scenario(lab)], FitCost())
    settings, kept = JdeSettings(10, 6), tmp_path / "c.npz"
    search = search_for(problem, settings, SearchOptions(checkpoint=kept))
    again, _ = Search.load(kept, search.identity)
    assert again.best_cost == search.best_cost
    assert np.array_equal(again.jde.population, search.jde.population)
    with pytest.raises(CheckpointError, match="differs in seed"):
        search_for(problem, settings, SearchOptions(seed=1, checkpoint=kept, resume=True))


def test_a_fit_is_kept_whose_errors_or_scores_cannot_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"free": ("alpha_l",), "population": 8, "generations": 2}
    fitted = fit_plant("kinematic", "traj4@kinematic", **options)

    def fail(*_: Any) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    real = fit_run.drive

    def diverge(plant: Any, piece: Any, *others: Any) -> Any:
        if not np.array_equal(piece.commands.values, TRAJECTORIES["traj4"].commands().values):
            raise DivergedError("it left the finite numbers")
        return real(plant, piece, *others)

    monkeypatch.setattr(fit_run, "estimate", fail)
    monkeypatch.setattr(fit_run, "drive", diverge)
    found = fit_plant("kinematic", "traj4@kinematic", held_out=("traj1",), **options)
    assert (found.cost, found.parameters[0].standard_error, found.held_out) == (fitted.cost, None, ())
    assert "Standard errors could not be estimated: Singular matrix." in found.remarks
    assert any("cannot be driven along traj1, which was held out" in remark for remark in found.remarks)
