"""Write the marked numbers of README and the Start pages from runs, or say which are stale.

`python docs/write_numbers.py [--data FOLDER]` writes, in some ten minutes; `--check` names stale
ones and exits with status 1. FOLDER has the recordings (*.csv), also in folders of it; without,
numbers of husky_tile_train.csv stay. A mark is `<!--=KEY-->`, what is written, and `<!--/-->`. A
number is stale that is off by more than 2 % and one of its last digits; real time, the last column
of a table, differs between computers.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from validation.calibrate import calibrate
from validation.compare import compare

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
MARK = re.compile(r"(<!--=([\w.]+)-->)(.*?)(<!--/-->)", re.DOTALL)
REAL_TIME = re.compile(r"(?<=\d) +\d+(?:\.\d+)?$", re.MULTILINE)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
NEW = "--wheelbase 0.512 --track 0.571 --wheel-radius 0.165 --wheel-width 0.125 --mass 73"
"""The robot of docs/your_robot.md."""
AFTER = "6"
"""Horizon whose errors the pages have [s]."""
FOLLOWERS = (
    "mpc",
    "lqr-scheduled+predictor",
    "lqr+predictor",
    "lqr tuned",
    "lqr robust",
    "lqr-scheduled tuned",
    "lqr published",
    "pid tuned",
    "pid published",
)
"""Rows of the table of controllers."""


def is_fresh(old: str, new: str) -> bool:
    """Return whether two texts have the same words and nearly the same numbers."""
    texts = [REAL_TIME.sub("", text) for text in (old, new)]
    words = [NUMBER.sub("#", text).split() for text in texts]
    if words[0] != words[1]:
        return False
    for a, b in zip(*map(NUMBER.findall, texts), strict=True):
        digit = 0.1 ** len(b.partition(".")[2])
        if not math.isclose(float(a), float(b), rel_tol=0.02, abs_tol=1.01 * digit):
            return False
    return True


def of_scenario() -> dict[str, str]:
    """Return what `compare traj4` says."""
    result = compare("traj4")
    plants = result.as_dict()["plants"]
    text = result.table(102).partition("Wheel loads")[0]
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    return {
        "traj4": "\n```text\n" + "\n".join(lines) + "\n```\n",
        "traj4.improved": f"{1e3 * plants['improved']['d_rms_m']:.1f}",
        "traj4.kinematic": f"{1e3 * plants['kinematic']['d_rms_m']:.0f}",
        "traj4.kinematic.sync": f"{1e3 * plants['kinematic']['sync_rms_m']:.0f}",
    }


def of_log() -> dict[str, str]:
    """Return what `compare husky` says of its windows."""
    plants = compare("husky", input="wheels", horizons=(6.0,)).as_dict()["plants"]
    errors = [plant["horizons"][AFTER]["overlapping"] for plant in plants.values()]
    places = [1e3 * error["position_median_m"] for error in errors]
    turns = [math.degrees(error["yaw_median_rad"]) for error in errors]
    of_turns = f"{min(turns):.1f} to {max(turns):.1f}"
    mujoco = plants["mujoco"]["horizons"][AFTER]["overlapping"]
    median, *ends = (100.0 * mujoco[f"position_{end}_m"] for end in ("median", "low", "high"))
    return {
        "husky.positions": f"{min(places):.0f} to {max(places):.0f}",
        "husky.turns": of_turns,
        "husky.mujoco": f"{median:.1f} cm ({ends[0]:.1f}–{ends[1]:.1f})",
    }


def with_interval(error: Mapping[str, Any], key: str, scale: float, unit: str) -> str:
    """Return a median and its interval as a cell of a table."""
    median, low, high = (scale * error[key.format(part)] for part in ("median", "low", "high"))
    digits = ".2g" if unit == "°" else ".3f"
    return f"{median:{digits}}{unit} ({low:{digits}}–{high:{digits}})"


def of_calibration() -> dict[str, str]:
    """Return what the robot of a tape measure does before and after its calibration."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "validation.robots", "new", "mine", *NEW.split()]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        robot = Path(folder) / "mine.toml"
        plants = ("mujoco", "kinematic")
        compared = compare("husky", robot=robot, input="wheels", plants=plants, horizons=(6.0,))
        calibrated = calibrate("husky", robot=robot, plants=plants)
        calibrated.save(folder)
        driver = (Path(folder) / "diff_drive.yaml").read_text(encoding="utf-8")
    fitted = calibrated.as_dict()["plants"]
    by_wheels = fitted["kinematic"]
    lines = ["", "| error after 6 s, unseen | before | after |", "|---|---|---|"]
    for title, errors in (("wheel rates", by_wheels), ("commands", by_wheels["commands"])):
        both = errors["before"][AFTER], errors["after"][AFTER]
        places = [with_interval(error, "position_{}_m", 1.0, " m") for error in both]
        turns = [with_interval(error, "yaw_{}_rad", 180.0 / math.pi, "°") for error in both]
        lines += [f"| from {title}: position | {' | '.join(places)} |"]
        lines += [f"| from {title}: heading | {' | '.join(turns)} |"]
    known = by_wheels["parameters"]
    medians = {
        f"before.{name}": f"{plant['horizons'][AFTER]['overlapping']['position_median_m']:.2f}"
        for name, plant in compared.as_dict()["plants"].items()
    }
    for title, errors in (("wheels", fitted["mujoco"]), ("commands", fitted["mujoco"]["commands"])):
        both = [errors[when][AFTER] for when in ("before", "after")]
        ends = [
            f"{e['position_median_m']:.3f} m and {math.degrees(e['yaw_median_rad']):.1f}°"
            for e in both
        ]
        medians[f"mujoco.{title}"] = " to ".join(ends)
    multiplier = float(driver.partition("wheel_separation_multiplier: ")[2].split()[0])
    medians["multiplier"] = f"{multiplier:.2f}"
    radii = {name: f"{known[name]['value']:.3f}" for name in ("alpha_l", "alpha_r")}
    return {"calibrated": "\n".join([*lines, ""]), **medians, **radii}


def of_tile(data: Path) -> dict[str, str]:
    """Return the errors on the part of a log that no fit has seen."""
    log = next(data.rglob("husky_tile_train.csv"))
    plants = ("mujoco", "improved", "coulomb", "linear", "kinematic", "four_wheel")
    options: dict[str, Any] = {"since": 500.0, "input": "wheels", "horizons": (6.0,)}
    judged = compare(log, "husky-tile", plants=plants, **options).as_dict()["plants"]
    errors = [plant["horizons"][AFTER]["overlapping"] for plant in judged.values()]
    places = [error["position_median_m"] for error in errors]
    least = min(places)
    most = max(places)
    return {
        "tile.positions": f"{1e3 * least:.0f}–{1e3 * most:.0f}",
        "tile.centimetres": f"{1e2 * most:.0f}",
    }


def of_following() -> dict[str, str]:
    """Return how closely controllers follow paths in MuJoCo, on two robots."""
    judged = []
    for profile in ("thesis-lab", "husky-tile"):
        with tempfile.TemporaryDirectory() as folder:
            words = ["--profile", profile, "--plants", "mujoco,kinematic", "--out", folder]
            command = [sys.executable, "-m", "validation.study", "transfer", *words, "--overwrite"]
            subprocess.run(command, check=True, capture_output=True)
            found = json.loads((Path(folder) / "study.json").read_text(encoding="utf-8"))
        judged.append(found["profiles"][profile]["plants"]["mujoco"]["contenders"])
    columns = []
    for of_robot in judged:
        for measure, scale in (("d_rms_m", 1e3), ("sync_rms_m", 1e3), ("cost", 1.0)):
            numbers = [scale * of_robot[name][measure] for name in FOLLOWERS]
            texts = [f"{n:.0f}" if scale > 1.0 or n >= 10.0 else f"{n:.1f}" for n in numbers]
            best = numbers.index(min(numbers))
            texts[best] = f"**{texts[best]}**"
            columns.append(texts)
    head = ["controller, gains"]
    for robot in ("lab's Husky", "Husky on tile"):
        head += [f"{robot}: off the path [mm]", "behind its target [mm]", "cost"]
    lines = [f"| {' | '.join(head)} |", "|---" + "|---:" * 6 + "|"]
    for row, name in enumerate(FOLLOWERS):
        law, _, gains = name.partition(" ")
        cells = [f"`{law}` {gains}".rstrip(), *(column[row] for column in columns)]
        lines.append(f"| {' | '.join(cells)} |")
    planned = judged[0]["mpc"]["d_rms_m"]
    published = judged[0]["pid published"]["d_rms_m"]
    return {
        "followers": "\n".join(["", *lines, ""]),
        "mpc.path": f"{1e3 * planned:.0f}",
        "pid.path": f"{1e3 * published:.0f}",
        "mpc.times": f"{published / planned:.1f}",
    }


def of_results() -> dict[str, str]:
    """Return the verdicts that docs/results.md has, which the replication writes."""
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    names = ("rows", "agree", "assumed", "differ", "vague", "cannot", "independent")
    numbers = re.findall(r"\d+", text.partition("**Of ")[2].partition(" independent ")[0])
    return {f"thesis.{name}": number for name, number in zip(names, numbers, strict=True)}


def main() -> int:
    """Write the numbers, or only check them; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, name stale numbers")
    parser.add_argument("--data", type=Path, help="folder with the recordings")
    given = parser.parse_args()
    values = of_scenario() | of_log() | of_calibration() | of_results() | of_following()
    if given.data is not None:
        values |= of_tile(given.data)
    stale = []
    for page in PAGES:

        def new(mark: re.Match[str], page: Path = page) -> str:
            begin, key, old, end = mark.groups()
            if key.startswith("tile.") and given.data is None:
                return mark[0]
            if is_fresh(old, values[key]):
                return mark[0]
            stale.append(f"{page.name}: {key} is {old.strip()}, now {values[key].strip()}")
            return f"{begin}{values[key]}{end}"

        text = page.read_text(encoding="utf-8")
        written = MARK.sub(new, text)
        if written != text and not given.check:
            page.write_text(written, encoding="utf-8")
    print("\n".join(stale) or "all numbers are those of today")
    return int(given.check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
