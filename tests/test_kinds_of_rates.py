"""Wheel rates at their stamps, and means since the stamp before: neither makes a robot late."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from validation.files.log import Log
from validation.fit import fit

FINE = 0.001
PERIOD = 0.05
RADIUS = 0.165
HALF_TRACK = 0.5


def log_of(rates: str) -> Log:
    """Two minutes of a robot that rolls without slip, with rates of a kind and 1 mm of noise."""
    rng = np.random.default_rng(3)
    t = FINE * np.arange(120_001)
    waves = rng.uniform(0.2, 1.2, (2, 6)), rng.uniform(0.0, 6.0, (2, 6))

    def sides(at: np.ndarray) -> np.ndarray:
        v, w = np.sin(at[:, None, None] * waves[0] + waves[1]).sum(axis=2).T
        return 3.0 + 0.6 * np.column_stack([v - w, v + w])

    middle = sides(t[:-1] + 0.5 * FINE)
    angles = np.vstack([[0.0, 0.0], FINE * np.cumsum(middle, axis=0)])
    yaw = RADIUS * (angles[:, 1] - angles[:, 0]) / (2.0 * HALF_TRACK)
    steps = RADIUS * FINE * middle.mean(axis=1) * np.exp(0.5j * (yaw[1:] + yaw[:-1]))
    place = np.concatenate([[0.0], np.cumsum(steps)])
    k = np.arange(0, len(t), round(PERIOD / FINE))
    seen = sides(t[k])
    if rates == "mean":
        seen[1:] = np.diff(angles[k], axis=0) / PERIOD
    poses = np.column_stack([place.real, place.imag, yaw])[k]
    poses += rng.normal(0.0, 0.001, poses.shape)
    table = np.column_stack([t[k], seen, poses])
    names = ("t", "enc_left", "enc_right", "x", "y", "yaw")
    return Log.of_columns("log.csv", dict(zip(names, table.T, strict=True)))


@pytest.mark.parametrize("said", ["instant", "mean"])
@pytest.mark.parametrize("kind", ["instant", "mean"])
def test_rates_of_each_kind_come_back_without_lateness(
    kind: str, said: Literal["instant", "mean"]
) -> None:
    """Taken for the other kind they are half a sample off."""
    fitted = fit("kinematic", log_of(kind), robot="husky", input="wheels", search="lsq", rates=said)
    off = {("mean", "instant"): -0.5, ("instant", "mean"): 0.5}.get((kind, said), 0.0) * PERIOD
    found = {p.name: p for p in fitted.parameters}
    for name in ("position_late", "yaw_late"):
        error = found[name].standard_error
        assert error is not None
        assert error < 0.1 * PERIOD
        assert found[name].value == pytest.approx(off, abs=2.0 * error)
