"""Programs on files, columns, profiles and folders with nasty names.

They work, and nothing raw leaves them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import exit_status
from tests.test_words import harmful
from tests.urdf_factory import UrdfRobot
from validation import cli
from validation.compare import compare
from validation.fit import fit
from validation.plants.profile import load_profile
from validation.recordings import PROGRAM as LOG_COMMANDS
from validation.robots import PROGRAM as ROBOT_COMMANDS
from validation.track import track
from validation.tune import tune

NAME = "n\x1b[31m$a_{\udcff\u202e[red]<b>`|(y)"
"""Of files: an escape sequence, a formula that ends nowhere, a byte that is no text, a turn of
direction, markup."""
COLUMN = "c[/x]<b>|`(z)$_{"
ENTRY = r"p\u001b]0;t\u0007$a_{\u202e[/x]<script>`|[y](javascript:1)"
"""Name in a TOML file, where control characters are escapes."""
SHIPPED = Path(cli.__file__).parents[1]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Go to a new folder with a recording, waypoints, profile and gains of nasty names."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(0.0, 8.0, 0.04)
    yaw = 0.3 * t
    columns = {
        "t": t,
        "cmd_v": 0 * t + 0.5,
        "cmd_w": 0 * t + 0.3,
        "enc_left": 0 * t + 3.0,
        "enc_right": 0 * t + 3.5,
        "x": np.sin(yaw) / 0.6,
        "y": (1.0 - np.cos(yaw)) / 0.6,
        "yaw": yaw,
        COLUMN: t,
    }
    rows = [
        ",".join(columns),
        *(",".join(f"{v:.6f}" for v in row) for row in zip(*columns.values(), strict=True)),
    ]
    Path(f"{NAME}.csv").write_text("\n".join(rows), encoding="utf-8")
    Path(f"w{NAME}.csv").write_text(
        "x,y\n" + "".join(f"{0.1 * i},{0.02 * i}\n" for i in range(12)), encoding="utf-8"
    )
    for kind, path in (
        ("p", "plants/profiles/thesis-lab.toml"),
        ("g", "experiment/gain_sets/pid-tuned.toml"),
    ):
        text = (SHIPPED / path).read_text(encoding="utf-8")
        renamed = re.sub(
            r"^(name|description) = .*$", lambda m: f'{m[1]} = "{ENTRY}"', text, flags=re.MULTILINE
        )
        Path(f"{kind}{NAME}.toml").write_text(renamed, encoding="utf-8")
    robot = (
        (SHIPPED.parent / "models" / "warthog.toml")
        .read_text(encoding="utf-8")
        .replace('name = "warthog"', 'name = "nasty"')
    )
    renamed = re.sub(
        r"^(title|description) = .*$", lambda m: f'{m[1]} = "{ENTRY}"', robot, flags=re.MULTILINE
    )
    Path(f"r{NAME}.toml").write_text(renamed, encoding="utf-8")
    urdf = (
        UrdfRobot(names=[f"{k}\u202e[red]$_{{" for k in "abcd"])
        .text()
        .replace('name="factory"', 'name="n\u202e[red]"')
    )
    Path(f"u{NAME}.urdf").write_text(urdf, encoding="utf-8")
    return tmp_path


FILE = f"{NAME}.csv"
WAYPOINTS = f"w{NAME}.csv"
PROFILE = f"p{NAME}.toml"
GAINS = f"g{NAME}.toml"
SEARCH = ("--profile", PROFILE, "--population", "8", "--generations", "1", "--workers", "1")
Main = Callable[..., Any] | Mapping[str, Callable[..., Any]] | cli.Program
RUNS: dict[str, tuple[Main, tuple[str, ...]]] = {
    "compare": (compare, (FILE, "--profile", PROFILE, "--plants", "linear", "--horizons", "2")),
    "info": (LOG_COMMANDS, ("info", FILE)),
    "convert": (LOG_COMMANDS, ("convert", FILE)),
    "check a robot": (ROBOT_COMMANDS, ("check", f"r{NAME}.toml")),
    "import a robot": (ROBOT_COMMANDS, ("import", f"u{NAME}.urdf", "--out", f"i{NAME}.toml")),
    "fit": (fit, ("linear", "--to", FILE, *SEARCH, "--name", NAME)),
    "track": (
        track,
        (
            "pid",
            WAYPOINTS,
            "--speed",
            "0.5",
            "--profile",
            PROFILE,
            "--plant",
            "linear",
            "--gains",
            GAINS,
        ),
    ),
    "tune": (tune, ("pid", "--reference", f"{WAYPOINTS}@0.5", "--plant", "linear", *SEARCH)),
}


@pytest.mark.parametrize("name", RUNS)
def test_a_program_works_and_lets_nothing_raw_out(
    name: str, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before, (main, arguments) = set(folder.rglob("*")), RUNS[name]
    assert exit_status(main, *arguments) == 0
    message = capfd.readouterr()
    assert not harmful(message.out, "\n")
    assert not harmful(message.err, "\n")
    written = {path for path in folder.rglob("*") if path.is_file()} - before
    assert written or name == "info"
    for path in written:
        assert path.resolve().is_relative_to(folder)
        if "--out" not in arguments:
            assert not harmful(str(path.relative_to(folder)))
        data = path.read_bytes()
        if path.suffix in (".json", ".md", ".html"):
            assert not harmful(data.decode("utf-8"), "\n")
        if path.suffix == ".toml":
            assert tomllib.loads(data.decode("utf-8"))
    if name == "fit":
        (profile,) = folder.glob("runs/fit/*/profile.toml")
        assert load_profile(profile).name.startswith("n\x1b")
