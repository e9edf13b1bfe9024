"""MJCF and URDF from others: the endless, too large or outside is refused in one line, soon."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from tests.conftest import processor_time
from tests.urdf_factory import UrdfRobot
from validation import load_robot
from validation.descriptions.importing import import_robot
from validation.simulator import foreign
from validation.simulator.composing import compose_robot
from validation.simulator.description import Robot, models_folder, parse_robot

pytestmark = pytest.mark.usefixtures("with_children")

MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def with_mjcf(folder: Path, more: str) -> Robot:
    """A Husky whose own MJCF has more in it."""
    text = (models_folder() / "husky.xml").read_text(encoding="utf-8")
    (folder / "mine.xml").write_text(
        text.replace("<worldbody>", f"{more}<worldbody>", 1), encoding="utf-8"
    )
    return parse_robot(
        {**load_robot("husky").as_document(), "name": "mine", "mjcf": "mine.xml"}, folder
    )


def test_an_mjcf_has_the_files_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.obj").write_text(MESH)
    (tmp_path / "more.xml").write_text(
        '<mujoco><asset><mesh name="arm" file="parts/arm.obj"/></asset></mujoco>'
    )
    model = compose_robot(with_mjcf(tmp_path, '<include file="more.xml"/>')).compile()
    assert model.nmesh == 1
    assert model.nbody == compose_robot(load_robot("husky")).compile().nbody


BODIES = (
    '<worldbody><replicate count="100000000" offset="1 0 0"><body><geom size="1"/></body>'
    "</replicate></worldbody>"
)
HOSTILE = {
    "bodies without end": BODIES,
    "keys without end": '<size nkey="2000000000"/>',
    "more memory than there is": '<size memory="9000G"/>',
    "a pipe": '<include file="pipe"/>',
    "a file elsewhere": '<include file="/etc/hostname"/>',
    "the folder above": '<asset><mesh name="m" file="../m.obj"/></asset>',
    "a link out": '<asset><mesh name="m" file="link.obj"/></asset>',
    "a model in a model": '<asset><model name="m" file="outer.xml"/></asset>',
    "entities": '<!DOCTYPE b [<!ENTITY a "aaaa">]>',
    "no XML": "<<",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_would_hang_or_reach_out_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "robot"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    (tmp_path / "m.obj").write_text(MESH)
    (folder / "link.obj").symlink_to(tmp_path / "m.obj")
    (folder / "outer.xml").write_text('<mujoco><include file="../inner.xml"/></mujoco>')
    (tmp_path / "inner.xml").write_text("<mujoco/>")
    monkeypatch.setattr(foreign, "ALLOWANCE", (0.5, 2 << 30, 0))
    robot = with_mjcf(folder, HOSTILE[name])
    began = processor_time()
    with pytest.raises(ValueError, match=r"mine\.xml: this is no MJCF that can be read") as refused:
        compose_robot(robot)
    assert "\n" not in str(refused.value)
    assert processor_time() - began < 8.0


def test_a_urdf_is_tried_in_a_process_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "r.urdf").write_text(UrdfRobot().text())
    monkeypatch.setattr(foreign, "ALLOWANCE", (10.0, 1 << 20, 0))
    with pytest.raises(match="Could not allocate memory"):
        import_robot(tmp_path / "r.urdf")


def test_what_is_included_is_read_in_the_child_and_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Empty elements are few bytes, but large objects: this process does not grow by them."""
    (tmp_path / "more.xml").write_text(f"<mujoco>{'<a/>' * ((1 << 24) - 10)}</mujoco>")
    monkeypatch.setattr(foreign, "ALLOWANCE", (5.0, 1 << 30, 0))
    robot = with_mjcf(tmp_path, '<include file="more.xml"/>')
    began = processor_time()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=r"mine\.xml: this is no MJCF that can be read"):
        compose_robot(robot)
    assert processor_time() - began < 25.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kilobytes


NANS = {
    "in it": '<option gravity="nan 0 0"/>',
    "in what it includes": '<include file="more.xml"/>',
}


@pytest.mark.parametrize("where", NANS)
def test_a_nan_is_refused_and_leaves_no_log_of_mujoco(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "more.xml").write_text(
        '<mujoco><custom><numeric name="n" data="NaN"/></custom></mujoco>'
    )
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    with pytest.raises(ValueError, match="it contains a NaN"):
        compose_robot(with_mjcf(tmp_path, NANS[where]))
    assert not list(work.iterdir())


def test_a_nan_in_a_urdf_leaves_no_log_of_mujoco(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = UrdfRobot().text().replace('<mass value="', '<mass value="nan" was="', 1)
    assert "nan" in text
    (tmp_path / "r.urdf").write_text(text)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    with pytest.raises(match=r"r\.urdf"):
        import_robot(tmp_path / "r.urdf")
    assert not list(work.iterdir())
