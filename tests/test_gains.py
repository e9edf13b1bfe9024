"""Gain sets: equal to the thesis' tables, round trips, and how mistakes are said."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.laws import LAWS
from ssmr.control.loop import LoopSettings
from ssmr.control.references import circle
from validation.experiment.gains import (
    FIELDS,
    SCHEMA,
    GainSet,
    dump_gains,
    load_gains,
    origin_sentence,
    shipped_sets,
)
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.identify.tuning import TuneCost, costs_of
from validation.plants.profile import load_profile, odometry_of, shipped_profiles

SETS = [(controller, name) for controller in FIELDS for name in shipped_sets(controller)]
"""Controller and name of every set that is shipped."""


def hopeless() -> GainSet:
    """A PID that stands still."""
    return GainSet("pid", "hopeless", dict.fromkeys(FIELDS["pid"], 0.0))


def document(**changes: Any) -> dict[str, Any]:
    """A good file of gains, changed."""
    gains = dict.fromkeys(FIELDS["lqr"], 1.0)
    return {
        "schema": SCHEMA,
        "controller": "lqr",
        "name": "mine",
        "source": "a test",
        "gains": gains,
    } | changes


def on_file(folder: Path, content: dict[str, Any] | bytes) -> Path:
    path = folder / "gains.toml"
    path.write_bytes(content if isinstance(content, bytes) else tomli_w.dumps(content).encode())
    return path


def refused(controller: str, name: str | Path) -> str:
    """The one line that it is refused with."""
    with pytest.raises(ValueError, match=r"gains|controller") as caught:
        load_gains(controller, str(name))
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --------------------------------------------------------------------------------------------------
# the shipped


@pytest.mark.parametrize(("controller", "short"), SETS)
def test_every_shipped_set_is_found_by_both_names_and_suits_its_controller(
    controller: str, short: str
) -> None:
    gains = load_gains(controller, f"{controller}-{short}")
    assert (gains.controller, gains.name) == (controller, f"{controller}-{short}")
    assert dump_gains(load_gains(controller, short)) == dump_gains(gains)
    LAWS[controller].gains(**gains.values)
    by_hand = set(gains.provenance["by_hand"])
    searched = set(gains.provenance.get("searched", ()))
    assert by_hand | searched == set(FIELDS[controller])
    assert not by_hand & searched


# --------------------------------------------------------------------------------------------------
# round trips


@given(
    st.sampled_from(sorted(FIELDS)), st.data(), st.text(st.characters(codec="utf-8"), max_size=9)
)
def test_a_set_survives_its_file(
    tmp_path_factory: pytest.TempPathFactory, controller: str, data: st.DataObject, text: str
) -> None:
    number = st.floats(allow_nan=False, allow_infinity=False)
    values = {name: data.draw(number) for name in FIELDS[controller]}
    gains = GainSet(controller, text, values, {"note": text, "seed": 3}, text)
    path = on_file(tmp_path_factory.mktemp("gains"), dump_gains(gains).encode())
    again = load_gains(controller, str(path))
    assert dict(again.values) == values
    assert (again.name, again.source, dict(again.provenance)) == (
        text,
        text,
        {"note": text, "seed": 3},
    )
    assert list(again.values) == list(FIELDS[controller])


# --------------------------------------------------------------------------------------------------
# mistakes

MISTAKES: dict[str, tuple[dict[str, Any] | bytes, str]] = {
    "another controller": (document(controller="pid"), "these are gains of pid, wanted lqr"),
    "unknown key": (
        document(gain=1),
        "the top level has unknown keys gain; there are: controller, gains, name",
    ),
    "no gains": (document(gains=3), "gains is 3, wanted a table"),
    "unknown": (
        document(gains={**document()["gains"], "q_z": 1.0}),
        "gains has unknown keys q_z; there are: k_alpha, k_i_rho",
    ),
    "missing": (
        document(gains={"q_x": 1.0, "q_v": 0.0}),
        "lacks q_yaw, q_w, r_v, r_w, k_alpha, k_y, k_i_rho; lqr needs",
    ),
    "nan": (
        document(gains={**document()["gains"], "k_y": math.nan}),
        "k_y is nan, wanted a finite number",
    ),
    "no TOML": (b"schema = \nname", "Invalid value"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_bad_file_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    content, message = MISTAKES[case]
    path = on_file(tmp_path, content)
    text = refused("lqr", path)
    assert message in text
    assert str(path) in text


OWN = [(controller, name) for controller, name in SETS if name in shipped_profiles()]
"""Sets that are shipped for a profile."""


def test_every_real_profile_has_gains_of_its_own() -> None:
    """For each law that has tuned gains.

    The other profiles are of the thesis' lab, where those come from.
    """
    tuned = [controller for controller, name in SETS if name == "tuned"]
    real = [name for name in shipped_profiles() if not name.startswith("thesis-")]
    assert {(c, p) for c in tuned for p in real} <= set(OWN)
    assert {p for _, p in OWN} <= set(shipped_profiles())


@pytest.mark.parametrize(("controller", "profile"), OWN)
def test_gains_of_a_profile_are_chosen_with_it_and_say_how_they_were_found(
    controller: str, profile: str
) -> None:
    gains = load_gains(controller, None, profile)
    assert gains.name == f"{controller}-{profile}"
    assert load_gains(controller, profile).values == gains.values
    assert gains.provenance["profile"] == profile
    assert gains.provenance["cost"] < gains.provenance["baseline_cost"]
    assert {"seed", "tuned_on", "searched", "options", "versions", "followed"} <= set(
        gains.provenance
    )
    assert origin_sentence(gains, profile) is None
    other = origin_sentence(load_gains(controller, "tuned"), profile)
    assert other is not None
    assert other.endswith(f"not on {profile}; there are {profile} gains of its own.")
    assert load_gains(controller, None, "thesis-lab").name in (
        f"{controller}-published",
        f"{controller}-tuned",
    )


@pytest.mark.parametrize(("controller", "profile"), OWN)
def test_gains_of_a_profile_cost_what_their_file_says(controller: str, profile: str) -> None:
    gains = load_gains(controller, profile)
    chosen = load_profile(profile)
    options = gains.provenance["options"]
    robot = make_robot(chosen, "improved")
    waypoints = circle(0.5)
    settings = LoopSettings(filter=odometry_of(robot.drive))
    runs = run_robots(
        [robot], [make_controller(chosen, gains)], [settings], waypoints, options["noise_seeds"]
    )
    cost = TuneCost(**{k: options[k] for k in ("k_rms", "k_haus", "k_ratio", "k_bend", "k_u")})
    measured = costs_of(runs, waypoints.trajectory(0.008), waypoints.rms_speed, cost)[0]
    message = gains.provenance["followed"]["circle at 0.5 m/s, improved"]["cost"]
    # other processors round otherwise, and noise makes that grow
    assert measured == pytest.approx(message, rel=1e-3)
