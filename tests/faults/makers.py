"""Good files of every kind, small, made by the project's own writers where it has any."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from tests import bag_factory
from tests.drive_train_logs import in_the_air, on_grass
from tests.faults.doors import ROOT

_ROOMS = ROOT / "validation"


def columns() -> dict[str, np.ndarray]:
    """Return the columns of a small recording: four seconds of an arc."""
    t = np.arange(0.0, 4.0, 0.04)
    yaw = 0.3 * t
    return {
        "t": t, "cmd_v": np.full_like(t, 0.5), "cmd_w": np.full_like(t, 0.3), "enc_left": 3.0 * t, "enc_right": 3.5 * t,
        "gyro_z": np.full_like(t, 0.3), "x": np.sin(yaw) / 0.6, "y": (1 - np.cos(yaw)) / 0.6, "yaw": yaw,
    }  # fmt: skip


def make_all(folder: Path) -> None:
    """Make a good file of each kind in a folder."""
    from validation.logs.bag_writer import write_bag
    from validation.logs.groups import groups_of
    from validation.logs.recording import Recording
    from validation.logs.recording_csv import write_csv

    recording = Recording.from_columns("good", columns())
    write_csv(recording, folder / "good.csv")
    for log in (in_the_air(commands=18), on_grass(commands=24)):
        write_csv(log, folder / f"{log.name}.csv")
    for suffix in (".bag", ".mcap"):
        write_bag(groups_of(recording, "good"), folder / f"good{suffix}")
    for kind in ("sqlite", "mcap folder"):
        bag_factory.write(folder, kind, lambda make: bag_factory.circle(make, 400), f"ros2-{kind.split()[0]}")
    rows = "x,y,t\n" + "".join(f"{0.1 * i},{0.004 * i * i},{0.4 * i}\n" for i in range(20))
    (folder / "way.csv").write_text(rows)
    for name, source in (("good", "thesis-lab"), ("husky", "husky-tile")):
        shutil.copy(_ROOMS / "plants" / "profiles" / f"{source}.toml", folder / f"{name}.toml")
    for law in ("pid", "smc"):
        shutil.copy(_ROOMS / "track" / "gain_sets" / f"{law}-tuned.toml", folder / f"{law}.toml")
    search = small_search()
    search.save(folder / "checkpoint.npz")


def small_search() -> Any:
    """Return a search of three generations."""
    from ssmr.search.jde import Jde, JdeSettings
    from validation.fit.search import Search

    jde = Jde(3, JdeSettings(population=8), seed=0)
    search = Search(jde, {"what": "a small one"})
    for _ in range(3):
        jde.tell(np.sum((jde.ask() - 0.3) ** 2, axis=1))
        search.remember()
    return search
