"""The replication: sections that are kept and used again, the report in its forms, and its numbers where they are simple."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.robot.localiser import Localiser
from ssmr.scenarios import TRAJECTORIES
from ssmr.search.jde import JdeSettings
from ssmr.simulation import SAMPLE_DT
from ssmr.types import State, Trajectory
from tests.conftest import ROUNDOFF, installed_plant
from validation.bench.sources import drive as drive_plant
from validation.bench.sources import open_source
from validation.engines.body import EngineMissingError
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.fit.problem import FitProblem
from validation.fit.result import FitResult
from validation.plants.profile import Profile, load_profile, make_plant
from validation.progress import Progress
from validation.replicate import QUICK_SETTINGS, Replication, ReplicationSettings, replicate
from validation.replicate import control as evidence_control
from validation.replicate import gazebo as evidence_gazebo
from validation.replicate import models as evidence_models
from validation.replicate import real as evidence_real
from validation.replicate.events import solve_with_events
from validation.replicate.evidence import (
    FIGURE_FOLDER,
    SECTION_FOLDER,
    Answer,
    Context,
    Findings,
    Picture,
    Section,
    Table,
    chosen_sections,
)
from validation.replicate.others import drive_all, every_cause, fitted_and_judged, standing_out
from validation.replicate.report import (
    document_html,
    document_of,
    linked,
)
from validation.replicate.run import ALL_SECTIONS, run_sections
from validation.replicate.tracked import CONTROL_TABLES, TableEntry
from validation.thesis import published
from validation.thesis.verdicts import STATUSES, Pair, Verdict, judge

SMALL = ReplicationSettings(fit_population=8, fit_generations=4, noise_seeds=1, repeats=1)
WANTED = {
    *"3.4 3.8 3.9 3.11 3.12 3.14 3.15 4.4 4.21 4.37 4.38".split(),
    *(
        "Sec. 3.5",
        "Sec. 3.5.4",
        "Sec. 3.6",
        "Sec. 3.7",
        "Fig. 2.9",
        "Fig. 3.33",
        "Sec. 4.3.3",
        "Sec. 4.5",
        "Sec. 4.5, motors",
    ),
    *(f"4.{i}" for i in (*range(5, 20), *range(22, 37))),
}


def section(key: str) -> Section:
    return next(s for s in ALL_SECTIONS if s.key == key)


def folders(path: Path) -> Path:
    for name in (SECTION_FOLDER, FIGURE_FOLDER):
        (path / name).mkdir(parents=True)
    return path


def run(keys: Sequence[str], folder: Path, settings: ReplicationSettings = SMALL) -> dict[str, Findings]:
    found = run_sections([section(k) for k in keys], settings, folder, workers=2)
    return {a.section.key: a.findings for a in found}


# ----------------------------------------------------------------------------------------------------------------- sections


def test_every_table_of_the_thesis_has_one_section_that_answers_for_it() -> None:
    answered = [t for s in ALL_SECTIONS for t in s.tables]
    assert len(answered) == len(set(answered))
    assert set(answered) == WANTED


def test_sections_are_chosen_by_key_and_by_table_in_their_own_order() -> None:
    assert [s.key for s in chosen_sections(ALL_SECTIONS, ("4.9", "times", "3.9"))] == ["fit-coulomb", "times", "tables"]
    assert chosen_sections(ALL_SECTIONS, ()) == ALL_SECTIONS
    with pytest.raises(ValueError, match=r"'5\.1' in only is no section"):
        chosen_sections(ALL_SECTIONS, ("times", "5.1"))


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures cost more than small searches; an empty file stands for each."""

    def written(self: Context, name: str, figure: object, caption: str) -> Picture:
        (self.folder / FIGURE_FOLDER / f"{name}.png").touch()
        return Picture(f"{name}.png", caption)

    monkeypatch.setattr(Context, "picture", written)
    monkeypatch.setattr(FitResult, "figure", lambda result: None)


@pytest.mark.usefixtures("no_pictures")
def test_a_broken_off_search_goes_on_to_the_same_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped in the third generation of the second section: the same findings in the end, and nothing is done twice."""
    through, broken = folders(tmp_path / "through"), folders(tmp_path / "broken")
    real, generations, ran = FitProblem.costs, list[str](), list[str]()
    both = [fake(FOUND, ran), section("fit-linear")]

    def counting(self: FitProblem, *args: Any) -> Any:
        generations.append(self.model)
        if stopped and len(generations) == 3:
            raise KeyboardInterrupt
        return real(self, *args)

    def findings(folder: Path) -> list[Findings]:
        return [found for _, found, *_ in run_sections(both, SMALL, folder, workers=2)]

    monkeypatch.setattr(FitProblem, "costs", counting)
    stopped = False
    undisturbed, wanted = findings(through), len(generations)
    stopped = True
    generations.clear()
    with pytest.raises(KeyboardInterrupt):
        findings(broken)
    assert [p.name for p in (broken / SECTION_FOLDER).glob("*.json")] == ["fake.json"]
    assert len(list((broken / SECTION_FOLDER).glob("fit-linear-*.npz"))) == 1
    stopped = False
    generations.clear()
    assert findings(broken) == undisturbed
    assert len(generations) == wanted - 2
    assert len(ran) == 2
    assert not list((broken / SECTION_FOLDER).glob("*.npz"))


@pytest.mark.usefixtures("no_pictures")
def test_a_damaged_search_begins_anew(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder, one = folders(tmp_path / "out"), section("fit-linear")
    state = Context(SMALL, folder, one.key, one.digest(SMALL), 1).checkpoint("search")
    state.write_bytes(b"no checkpoint")
    assert run(["fit-linear"], folder)["fit-linear"].tables
    assert "begins anew" in caplog.text


def fake(found: Findings, ran: list[str], needs: tuple[str, ...] = ("seed",)) -> Section:
    def compute(context: Any) -> Findings:
        ran.append(context.key)
        return found

    return Section("fake", "A section", ("3.9",), needs, compute)


FOUND = Findings(
    {
        "3.9": Table(
            "a caption", {"traj1": {"d_rms_m": Pair(0.1416, 0.0074, "distance", "m", 0.001, {"mujoco": 0.2}, "none")}}
        )
    },
    notes=("a note",),
    numbers={"a": [1.0, None]},
)


def test_what_is_kept_is_used_again_only_for_the_same_question(tmp_path: Path) -> None:
    folder, ran = folders(tmp_path / "out"), list[str]()
    one = fake(FOUND, ran)
    for settings, times in ((SMALL, 1), (SMALL, 1), (replace(SMALL, repeats=9), 1), (replace(SMALL, seed=7), 2), (SMALL, 3)):
        ((_, found, *_),) = run_sections([one], settings, folder)
        assert found == FOUND
        assert len(ran) == times
    state = folder / SECTION_FOLDER / "fake-search.0123456789ab.npz"
    state.touch()
    anew = replace(one, run=lambda context: (ran.append(f"state: {state.exists()}"), FOUND)[1])
    run_sections([anew], SMALL, folder, fresh=True)
    assert ran[3:] == ["state: False"]


@pytest.fixture(scope="module")
def accelerations(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Findings]:
    """That section, and the folder where it is kept."""
    folder = folders(tmp_path_factory.mktemp("accelerations") / "out")
    return folder, run(["accelerations"], folder)["accelerations"]


def test_a_recording_is_known_by_its_content(tmp_path: Path) -> None:
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    a.write_text("one", encoding="utf-8")
    b.write_text("one", encoding="utf-8")
    digests = [section("real").digest(replace(SMALL, recording=str(p))) for p in (a, b)]
    b.write_text("two", encoding="utf-8")
    assert digests[0] == digests[1] != section("real").digest(replace(SMALL, recording=str(b)))


# ------------------------------------------------------------------------------------------------------------------ numbers


def test_chattering_coulomb_and_smooth_improved_as_in_figure_3_33(accelerations: tuple[Path, Findings]) -> None:
    rows = accelerations[1].tables["Fig. 3.33"].rows
    counts = {name: rows[name]["alternations"].ours for name in ("coulomb", "improved", "linear")}
    assert counts["improved"] == counts["linear"] == 0.0
    assert counts["coulomb"] is not None
    assert counts["coulomb"] > 100.0
    delays = [rows[name]["speed_delay_s"].ours for name in ("coulomb", "improved", "linear", "mujoco")]
    assert all(d is not None and 0.2 < d < 0.3 for d in delays)  # 0.22 s of Tab. 3.8, and the first tenth of the rise


def test_the_published_lines_meet_the_published_dry_friction_where_the_section_says(tmp_path: Path) -> None:
    """And with their slopes at rest they would be those of arctangents far less steep than the one of Fig. 2.9."""
    (findings,) = run(["friction"], folders(tmp_path / "out")).values()
    found = {name: row["value"].ours for name, row in findings.tables["Fig. 2.9"].rows.items()}
    u_x, mu_c, k_u, k_y = 0.0727, 0.0254, 0.0277, 0.0298  # Tab. 3.8, 3.14
    assert list(found.values()) == pytest.approx(
        [math.pi / 2 * k_u / u_x, math.pi / 2 * k_y / mu_c, u_x / (4.0 * k_u), mu_c * 0.256 / (k_y * 0.275)], rel=ROUNDOFF
    )
    assert [p.file for p in findings.pictures] == ["friction-laws.png"]


def test_the_noise_of_the_simulated_lab_is_found_by_the_procedure_of_the_thesis(tmp_path: Path) -> None:
    """White noise of the printed variances leaves the share that the filter lets pass; wrong stamps are noise of X alone."""
    (findings,) = run(["noise"], folders(tmp_path / "out"), replace(SMALL, noise_seeds=3)).values()
    rows, kept = {name: pairs["variance"] for name, pairs in findings.tables["3.4"].rows.items()}, 0.623
    for name, pair in rows.items():
        assert pair.published is not None
        assert pair.ours is not None
        assert pair.beside["of what is simulated"] == pytest.approx(kept * pair.published, rel=0.15), name
        assert (pair.beside["with jitter"] > 100.0 * pair.ours) == (name == "X")
    assert len(next(iter(findings.grids.values())).groups[0]) == len(published.table("3.3")["rows"])


def test_missed_ticks_shorten_the_way_that_the_filter_believes_in(tmp_path: Path) -> None:
    (findings,) = run(["faults"], folders(tmp_path / "out")).values()
    rows = next(iter(findings.grids.values())).groups[0]
    share, along = np.array([[float(row[0].text), float(row[1].text)] for row in rows]).T
    length = 10.8e3
    assert -np.diff(along) / np.diff(share) == pytest.approx(0.5 * length / 100.0, rel=0.1)


def test_delay_and_rise_of_known_answers() -> None:
    t = np.linspace(0.0, 5.0, 5001)
    lag = np.where(t > 0.3, 1.0 - np.exp(-(t - 0.3) / 0.1), 0.0)
    delay, rise = evidence_models.delay_and_rise(t, -2.0 * lag)
    assert delay == pytest.approx(0.3 + 0.1 * math.log(1.0 / 0.9), abs=1e-4)
    assert rise == pytest.approx(0.1 * math.log(9.0), abs=1e-4)
    assert all(map(math.isnan, evidence_models.delay_and_rise(t, 0.0 * t)))


def test_alternations_are_samples_of_another_sign_than_both_neighbours() -> None:
    assert evidence_models.alternations(np.array([1.0, -1.0, 1.0, -1.0, -1.0, 2.0])) == 2
    assert evidence_models.alternations(np.sin(np.linspace(0.0, 20.0, 500))) == 0


def test_located_changes_of_sign_cost_the_coulomb_model_the_most_time() -> None:
    """The turn reverses three times; the compiled loops end with the same velocities."""
    scenario = replace(TRAJECTORIES["traj4"], duration=8.5)
    found = {name: solve_with_events(name, scenario) for name in ("coulomb", "improved", "linear")}
    assert found["linear"].located == 0
    assert 0 < found["improved"].located < 0.1 * found["coulomb"].located
    assert found["linear"].evaluations < found["improved"].evaluations < 0.6 * found["coulomb"].evaluations
    profile = load_profile("thesis-printed")
    for name, effort in found.items():
        last = make_plant(profile, name).run(scenario.commands(), State(), SAMPLE_DT).twist[-1]
        assert effort.end == pytest.approx(last[[0, 2]], abs=0.03)  # there the command is held for 50 ms


def test_only_the_limit_of_the_motors_makes_trajectory_1_stand_out() -> None:
    """Printed: 142 mm, where the others have 22, 25 and 15."""
    found = {}
    for name in ("none: stiff tyres, ample motors", "left motors 5 % stronger", "motors end at 9 N m a wheel"):
        judged = fitted_and_judged(drive_all(every_cause()[name], 1), JdeSettings(20, 12, patience=13), 1, 2)
        found[name] = standing_out({t: metrics["d_rms_m"] for t, (metrics, _) in judged.items()})
    assert found.pop("motors end at 9 N m a wheel") > 2.5 > 1.5 > max(found.values())


def test_causes_add_up_and_noise_depends_on_the_seed_alone() -> None:
    causes = every_cause()
    whole = causes["all of these, with 7 N m"]
    assert (whole.noise, whole.localiser.tracked_x, whole.drive["torque_limit"]) == (True, 0.1, 7.0)
    noisy = [drive_all(causes["noise of the tracker"], seed)["traj1"][1].pose for seed in (1, 1, 2)]
    assert np.array_equal(noisy[0], noisy[1])
    assert not np.array_equal(noisy[0], noisy[2])


def entry(controller: str, mean: float, deviation: float, n: int = 10) -> TableEntry:
    values = {m: mean for m in ("d_rms_m", "d_haus_m", "d_ratio")}
    return TableEntry("4.13", "simulated_vs_real", controller, controller, "line", 0.25, values, values,
                 {m: deviation for m in values}, 0, n, {})  # fmt: skip


def test_a_change_in_percent_carries_both_spreads() -> None:
    change, spread = evidence_control.change_percent(entry("pid", 0.002, 0.0002), entry("lqr", 0.003, 0.0006), "d_rms_m")
    assert change == pytest.approx(50.0, rel=ROUNDOFF)
    assert spread == pytest.approx(150.0 * math.hypot(0.1, 0.2), rel=ROUNDOFF)
    assert evidence_control.change_percent(entry("pid", 0.002, 0.0, 1), entry("lqr", 0.003, 0.0, 1), "d_rms_m")[1] is None
    lost = replace(entry("pid", 0.002, 0.0), mean={})
    assert evidence_control.change_percent(lost, entry("lqr", 0.003, 0.0), "d_rms_m") == (None, None)


def test_every_searched_gain_of_the_thesis_is_one_of_ours() -> None:
    for controller, number in evidence_control.TUNED_TABLES.items():
        assert set(evidence_control.GAIN_NAMES[controller]) == set(published.table(number)["rows"])


def drive(t: np.ndarray, speed: float, rate: float) -> Log:
    yaw = rate * t
    x, y = speed / rate * np.sin(yaw), speed / rate * (1.0 - np.cos(yaw))
    turn = rate * 0.5708 / 2.0 * 1.8
    wheels = {"enc_left": np.full_like(t, (speed - turn) / 0.165), "enc_right": np.full_like(t, (speed + turn) / 0.165)}
    return Log.of_columns("drive.csv", {"t": t, "x": x, "y": y, "yaw": yaw, **wheels})


def test_a_recording_without_commands_is_driven_by_its_wheels(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    write_csv(drive(np.arange(0.0, 40.0, 0.05), 0.25, 0.4), path)
    settings = replace(SMALL, recording=str(path), split=25.0)
    (findings,) = run(["real"], folders(tmp_path / "out"), settings).values()
    assert set(findings.numbers["horizons"]) == {"wheels"}
    residuals = findings.numbers["residuals_wheels"]
    row, column = 2, 2  # 0.2-0.3 m/s, 0.3-0.6 rad/s
    count = np.array(residuals["windows"])
    assert count.sum() == count[row, column] == 12 + 7  # of 25 and of 15 s: windows end at samples, none spans the split
    assert all(v[row][column] is not None for v in residuals["yaw_median_rad"].values())
    assert sum(v is not None for line in residuals["yaw_median_rad"]["mujoco"] for v in line) == 1
    page = document_html(
        document_of([Answer(section("real"), findings, 1.0, 1.0)], settings), tmp_path / "out" / FIGURE_FOLDER
    )
    assert page.count("data:image/png;base64,") == 2


# ------------------------------------------------------------------------------------------------------------------- report


FEW = replace(QUICK_SETTINGS, fit_population=8, fit_generations=3, repeats=2)
SOME = ("3.9", "times", "real")


@pytest.fixture(scope="module")
def replication(tmp_path_factory: pytest.TempPathFactory) -> Replication:
    """A small replication, written where it is kept."""
    out = tmp_path_factory.mktemp("replicate")
    found = replicate(FEW, SOME, out)
    assert [p.name for p in found.save(out)] == ["replicate.html", "replicate.md", "replicate.json"]
    found.publish(out / "docs" / "results.md")
    return found


@pytest.fixture(scope="module")
def report(replication: Replication) -> Path:
    return replication.folder


def test_numbers_are_printed_beside_ours_with_a_verdict(report: Path) -> None:
    document = json.loads((report / "replicate.json").read_text(encoding="utf-8"))
    assert document["schema"] == "ssmr.replicate/1"
    assert document["quick"] is True
    assert list(document["tables"]) == ["3.8", "3.9", "Sec. 3.6"]
    for number, table in document["tables"].items():
        for row, metrics in table["rows"].items():
            assert table["verdicts"][row]["verdict"] in STATUSES
            for metric, pair in metrics.items():
                assert {"published", "ours"} <= set(pair)
                assert pair["verdict"] == "agrees" or pair["reason"], (number, row, metric)
    for row, printed in published.table("3.9")["rows"].items():
        for metric, value in printed.items():
            assert document["tables"]["3.9"]["rows"][row][metric]["published"] == value
    assert document["tables"]["3.8"]["rows"]["tau_max_wheel_N_m"]["value"]["verdict"] == "not compared"
    assert sum(document["verdicts"].values()) == 6 + 4 + 3


def test_markdown_holds_every_row_and_docs_link_their_pages(report: Path) -> None:
    text = (report / "replicate.md").read_text(encoding="utf-8")
    for row in published.table("3.8")["rows"]:
        assert f"| {row} |" in text
    assert "Not run: no recording was given" in text
    pictures = [line.rpartition("(")[2].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert pictures
    assert all((report / p).is_file() for p in pictures)
    page = (report / "docs" / "results.md").read_text(encoding="utf-8")
    assert "](identification.md)" in page
    assert "docs/identification.md" not in page
    assert (report / "docs" / "img" / "results-fit-coulomb-fit.png").is_file()
    assert linked("see docs/a.md, and [docs/b.md](docs/b.md)", "../") == "see [a.md](../a.md), and [docs/b.md](docs/b.md)"


def test_a_second_run_keeps_everything_and_says_so(report: Path) -> None:
    before, said = (report / "replicate.json").read_bytes(), list[Progress]()
    replicate(FEW, SOME, report, progress=said.append).save(report)
    assert [now.text.rpartition(", ")[2] for now in said if now.done == int(now.done) > 0].count("kept from before") == 3
    assert (report / "replicate.json").read_bytes() == before


def test_a_robot_that_turns_as_its_wheels_ask_never_drives_straight() -> None:
    """Half of the hard turns without any yaw rate is half of them, and soft turns do not count."""
    asked = np.array([1.0, 1.0, -1.0, -1.0, 0.1, 0.1])
    wheels = np.column_stack([3.0 - asked, 3.0 + asked])
    t = 0.1 * np.arange(6)
    for share, kept in ((0.0, np.ones(6)), (0.5, np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0]))):
        twist = np.column_stack([np.ones(6), np.zeros(6), 0.4 * asked * kept])
        motion = Trajectory(t, np.zeros((6, 3)), twist, wheels)
        assert evidence_gazebo.straight_share(motion, 0.16, 0.28) == pytest.approx(share)


def test_without_ode_the_section_on_gazebo_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(evidence_gazebo, "ode", lambda: None)
    whole = section("gazebo").digest(SMALL)

    def missing() -> None:
        raise EngineMissingError("install it")

    monkeypatch.setattr(evidence_gazebo, "ode", missing)
    findings = section("gazebo").run(Context(SMALL, tmp_path, "gazebo", "", 1))
    for row in findings.tables["Sec. 3.7"].rows.values():
        assert judge("Sec. 3.7", "box", "straight_share", row["straight_share"]) == Verdict("not compared", "install it")
    assert section("gazebo").digest(SMALL) != whole  # once it is installed, the section runs anew


def test_gazebo_s_pyramid_drives_straight_as_the_thesis_saw_it(lab: Profile) -> None:
    """With friction along the world's axes and the weight to the right: see Sec. 3.7 and docs/engines.md."""
    installed_plant(lab, "ode")
    improved = drive_plant(make_plant(lab, "improved"), open_source("traj3").pieces[0], Localiser(), 0.01)
    found = evidence_gazebo.driven_on_trajectory_3("pyramid", "world", improved)
    assert found.straight > 0.9
    assert 0.4 < found.excess < 0.5


def test_the_page_of_docs_is_a_whole_replication() -> None:
    """Nobody wrote it by hand, or published a quick or a partial one: titles and lead are those of this code."""
    text = (Path(__file__).resolve().parents[1] / "docs" / "results.md").read_text(encoding="utf-8")
    found = [Answer(s, Findings(), 0.0, 0.0) for s in ALL_SECTIONS]
    expected = document_of(found, ReplicationSettings())
    assert text.startswith(f"# {expected.title}\n\n{expected.lead[0]}\n")
    for chapter in expected.chapters:
        assert f"\n## {chapter.title}\n" in text
    for number in WANTED - set(CONTROL_TABLES):
        assert f"**{number if not number[0].isdigit() else f'Tab. {number}'}. " in text
    assert all(f"\n| {number} | " in text for number in CONTROL_TABLES)
    assert evidence_real.NOT_RUN not in text


# ------------------------------------------------------------------------------------------------------------- command line


def test_an_interrupt_leaves_with_130_and_keeps_the_search(tmp_path: Path) -> None:
    program = (
        "import os, signal, sys; sys.argv = ['replicate', '--quick', '--only', '3.15', '--out', 'out'];"
        "from validation import cli; from validation.replicate.__main__ import main;"
        "from validation.fit.problem import FitProblem as P; real, calls = P.costs, [];"
        "P.costs = lambda *a: (calls.append(1), len(calls) == 3 and os.kill(os.getpid(), signal.SIGINT), real(*a))[2];"
        "cli.run(main, 'replicate')"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=120)
    assert done.returncode == 130, done.stderr
    assert "0 of 1 sections are kept in out" in done.stderr
    assert "Traceback" not in done.stderr
    assert len(list((tmp_path / "out" / SECTION_FOLDER).glob("fit-linear-search.*.npz"))) == 1
