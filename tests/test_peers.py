"""The controllers of others that docs/make_peers.py drives beside those of this project."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ssmr.control.references import winding_path
from validation.track import track


def load_peers() -> ModuleType:
    """Return the module of docs/ that drives the controllers of others."""
    path = Path(__file__).resolve().parents[1] / "docs" / "make_peers.py"
    spec = importlib.util.spec_from_file_location("make_peers", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def peers() -> ModuleType:
    return load_peers()


@pytest.mark.parametrize("name", ["MPPI, predictor", "the same, look-ahead halved", "mpc"])
def test_a_peer_follows_a_short_path(peers: ModuleType, name: str) -> None:
    """Within 50 mm on the model, and near the end when the target is there."""
    path = winding_path(0.5, [0.0, 1.0, -1.0])
    spent: list[float] = []
    tracked = track(peers.timed(peers.PEERS[name], spent), path, no_noise=True)
    xy = tracked.motion("improved").xy
    assert not tracked.robots[0].run.lost
    assert peers.path_error(xy, path.xy) < 0.05
    assert np.hypot(*(xy[-1] - path.xy[-1])) < 0.4
    # a command every 50 ms
    assert len(spent) >= 20 * path.duration


def test_the_path_error_is_the_distance_to_the_path(peers: ModuleType) -> None:
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    beside = np.tile([[0.5, 0.3]], (9, 1))
    assert peers.path_error(beside, corner) == pytest.approx(0.3)
    beyond = np.tile([[1.3, 1.4]], (9, 1))
    assert peers.path_error(beyond, corner) == pytest.approx(0.5)


def test_the_nonlinear_program_is_that_of_mpc(peers: ModuleType) -> None:
    """Where the plan is nearly straight its linearisation is exact, and both drive alike."""
    pytest.importorskip("casadi")
    path = winding_path(0.4, [0.0, 0.2])
    both = [track(kind, path, no_noise=True) for kind in (peers.OurMpc, peers.Nmpc)]
    ours, theirs = (tracked.motion("improved").xy for tracked in both)
    assert np.abs(ours - theirs).max() < 0.002
