"""A search that has ended loses nothing to what comes after it: drawing, recording, scores, standard errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.errors import DivergedError
from ssmr.scenarios import TRAJECTORIES
from validation.fit import run as fit_run
from validation.fit.result import FitResult
from validation.fit.run import fit
from validation.plants.profile import load_profile


@pytest.fixture(scope="module")
def fitted() -> FitResult:
    return fit("kinematic", "traj4@kinematic", free=("alpha_l",), population=8, generations=2)


@pytest.mark.parametrize("part", ["figure", "write_recording"])
@pytest.mark.parametrize("error", [OSError("no space"), ValueError("no glyph"), KeyboardInterrupt()], ids=repr)
def test_numbers_are_written_though_the_rest_fails(
    fitted: FitResult, part: str, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(FitResult, part, fail)
    with pytest.raises(type(error)):
        fitted.save(tmp_path, recording=True)
    assert json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))["cost"] == fitted.cost
    assert load_profile(tmp_path / "profile.toml").plants["kinematic"] == fitted.profile.plants["kinematic"]


def test_a_fit_is_kept_whose_errors_or_scores_cannot_be_had(monkeypatch: pytest.MonkeyPatch, fitted: FitResult) -> None:
    def fail(*_: Any) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    real = fit_run.drive

    def diverge(plant: Any, piece: Any, *others: Any) -> Any:
        if not np.array_equal(piece.commands.values, TRAJECTORIES["traj4"].commands().values):
            raise DivergedError("it left the finite numbers")
        return real(plant, piece, *others)

    monkeypatch.setattr(fit_run, "estimate", fail)
    monkeypatch.setattr(fit_run, "drive", diverge)
    options: dict[str, Any] = {"free": ("alpha_l",), "population": 8, "generations": 2}
    found = fit("kinematic", "traj4@kinematic", held_out=("traj1",), **options)
    assert (found.cost, found.parameters[0].standard_error, found.held_out) == (fitted.cost, None, ())
    assert "Standard errors could not be estimated: Singular matrix." in found.remarks
    assert any("cannot be driven along traj1, which was held out" in remark for remark in found.remarks)


OUT_OF_RANGE: list[dict[str, Any]] = [
    {"until": float("inf")}, {"start_at": float("nan")}, {"seed": 2**63}, {"seed": -1}, {"seed": 10**400}, {"seed": 1.5},
    {"target": float("-inf")}, {"workers": 0}, {"population": 10**9}, {"generations": 0}, {"k_rms": float("inf")},
    {"horizons": (1e9,)}, {"horizons": (float("nan"),)}, {"horizons": tuple(range(1, 200))}, {"input": "both ways"},
    {"df": float("nan")}, {"patience": 0}, {"fix": {"alpha_l": float("nan")}}, {"bounds": {"alpha_l": (0.0, float("inf"))}},
]  # fmt: skip


@pytest.mark.parametrize("options", OUT_OF_RANGE, ids=lambda options: f"{next(iter(options))}-{str(options)[:40]}")
def test_what_no_file_could_hold_is_refused_before_the_search(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_run, "search_for", lambda *_: pytest.fail("the search began"))
    with pytest.raises(ValueError, match=next(iter({"fix": "alpha_l", "bounds": "alpha_l"}.get(n, n) for n in options))):
        fit("kinematic", "traj4@kinematic", **{"free": None if "fix" in options else ("alpha_l",)} | options)
