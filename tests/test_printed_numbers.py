"""Numbers of the core that come from the thesis are printed there: gains, a switch, a line."""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest

from ssmr.control.laws import LAWS, Controller
from ssmr.control.loop import LoopSettings
from ssmr.control.pid import PidGains
from ssmr.control.references import line
from ssmr.control.waypoints import ALPHA_SWITCH
from ssmr.metrics.declared import compare_paths
from tests.test_closed_loop import TRUTH, A, B, drive, model
from validation.experiment.gains import load_gains
from validation.replicate import published

PRINTED = {
    "pid": (
        "K_P_u K_I_u K_P_omega K_I_omega K_P_FF_u K_P_FF_omega "
        "K_P_rho K_I_rho K_P_y K_I_y K_P_alpha K_I_alpha"
    ).split(),
    "lqr": "Q_11 Q_22 Q_33 Q_44 R_11 R_22 K_alpha K_y K_I_rho".split(),
}
"""Names of the thesis, in the order of ours."""
FROM = {
    "pid-published": ("4.4", "value"),
    "lqr-published": ("4.21", "optimised"),
    "lqr-manual": ("4.21", "manual"),
}
"""Table and column of each shipped set."""
LAST_DIGIT = 0.5e-4
"""Half a unit of the last digit that the thesis prints of d_haus and d_ratio."""


@pytest.mark.parametrize("name", FROM)
def test_shipped_gains_are_the_printed_ones(name: str) -> None:
    controller = name.partition("-")[0]
    number, column = FROM[name]
    gains = load_gains(controller, name)
    theirs = PRINTED[controller]
    assert list(gains.values.values()) == [
        published.printed_value(number, each, column) for each in theirs
    ]
    assert set(theirs) == set(published.printed_table(number)["rows"])
    assert gains.provenance["table"] == number
    assert f"Tab. {number}" in gains.source
    assert (
        name.endswith("manual")
        or LAWS[controller].gains(**gains.values) == LAWS[controller].gains()
    )


def test_the_switch_is_the_published_one() -> None:
    assert published.printed_value("text", "alpha_switch_distance") == ALPHA_SWITCH


@pytest.mark.parametrize("disturbed", [False, True])
@pytest.mark.parametrize(
    ("number", "row", "speed"), [("4.5", "line_0.25", 0.25), ("4.6", "line_0.50", 0.5)]
)
def test_published_gains_on_the_published_model_reproduce_the_published_line(
    number: str, row: str, speed: float, disturbed: bool
) -> None:
    """The robot lags by v / K_P exp(-K_I / K_P t), and so is short of the end when time is up.

    The whole gap is d_haus, and its share of the length is 1 - d_ratio: K_P, K_I, speed and length
    say both.
    """
    way = line(speed)
    gains = PidGains(**load_gains("pid", "published").values)
    settings = LoopSettings() if disturbed else TRUTH
    run = drive(model("improved"), Controller(gains, A, B), way, settings)
    metrics = compare_paths(run.motion, way.trajectory(float(run.t[1])))
    gap = way.length - run.state.x
    assert metrics["d_ratio"] == pytest.approx(
        published.printed_value(number, row, "d_ratio"), abs=0.001
    )
    assert metrics["d_haus_m"] == pytest.approx(
        published.printed_value(number, row, "d_haus_m"), rel=0.25
    )
    assert metrics["d_haus_m"] == pytest.approx(gap, rel=0.01)
    predicted = speed / gains.k_p_rho * math.exp(-gains.k_i_rho / gains.k_p_rho * way.duration)
    assert predicted == pytest.approx(published.printed_value(number, row, "d_haus_m"), rel=0.25)
    if not disturbed:  # noise moves the end by some millimetres
        assert gap == pytest.approx(predicted, rel=0.03)  # the slow root to first order


def lengths_by(number: str) -> tuple[float, float]:
    """Lengths of the line that a table's printed digits allow.

    A robot short by d_haus lacks the share 1 - d_ratio.
    """
    (row,) = published.printed_table(number)["rows"]
    gap = published.printed_value(number, row, "d_haus_m")
    missing = 1.0 - published.printed_value(number, row, "d_ratio")
    return (gap - LAST_DIGIT) / (missing + LAST_DIGIT), (gap + LAST_DIGIT) / (missing - LAST_DIGIT)


def test_the_length_of_the_line_is_what_the_tables_allow() -> None:
    length = inspect.signature(line).parameters["length"].default
    bounds = np.array([lengths_by(number) for number in ("4.5", "4.6", "4.22", "4.23")])
    low = np.max(bounds[:, 0])
    high = np.min(bounds[:, 1])
    # what docs/errata.md says of all four
    assert (round(low, 2), round(high, 2)) == (10.79, 10.85)
    assert low < length < high
