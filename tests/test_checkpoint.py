"""Checkpoints: what was written comes back, and whatever a file of that name holds, the answer is one line."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.search.jde import Jde, JdeSettings
from validation.fit.checkpoint import CheckpointError, read_arrays, write_arrays
from validation.fit.search import Search

IDENTITY = {"model": "a", "seed": "b"}


def search(generations: int = 3) -> Search:
    """A search that has gone through some generations."""
    found = Search(Jde(2, JdeSettings(6, 10), 1), IDENTITY)
    for _ in range(generations):
        found.jde.tell(np.sum(found.jde.ask(), axis=1))
        found.remember()
    return found


@pytest.fixture
def path(tmp_path: Path) -> Path:
    found = tmp_path / "checkpoint.npz"
    search().save(found)
    return found


def refused(path: Path) -> str:
    with pytest.raises(CheckpointError) as caught:
        Search.load(path, IDENTITY)
    assert "\n" not in str(caught.value)
    assert "checkpoint.npz" in str(caught.value)
    return str(caught.value)


def test_what_is_written_comes_back(path: Path) -> None:
    again, versions = Search.load(path, IDENTITY)
    whole = search()
    assert again.best_cost == whole.best_cost
    assert again.median_cost == whole.median_cost
    assert "numpy" in versions
    for one, other in zip(again.jde.state().values(), whole.jde.state().values(), strict=True):
        assert np.array_equal(one, other)
    with np.load(path, allow_pickle=False) as file:  # it stays an .npz file that others can read
        assert set(file.files) > {"jde_population", "fit_identity"}


@given(data=st.data())
def test_no_change_of_bytes_gets_through(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("changed") / "checkpoint.npz"
    search().save(path)
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.sampled_from([len(whole), len(whole) // 2, len(whole) - 1]))])
    try:
        again, _ = Search.load(path, IDENTITY)
    except CheckpointError:
        return
    assert np.array_equal(again.jde.population, search().jde.population)  # a byte that decides nothing, such as a date


def rewritten(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change arrays of a checkpoint, as somebody does who knows how the digest is made."""
    arrays: dict[str, Any] = dict(read_arrays(path))
    change(arrays)
    write_arrays(path, arrays)


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "no identity": lambda a: a.pop("fit_identity"),
    "identity is no JSON": lambda a: a.update(fit_identity=np.array("{")),
    "identity is nested": lambda a: a.update(fit_identity=np.array("[" * 9999)),
    "identity is a list": lambda a: a.update(fit_identity=np.array("[]")),
    "versions are numbers": lambda a: a.update(fit_versions=np.array('{"numpy": 3}')),
    "time is infinite": lambda a: a.update(fit_wall_s=np.array(np.inf)),
    "time is a table": lambda a: a.update(fit_wall_s=np.zeros((3, 3))),
    "time is text": lambda a: a.update(fit_wall_s=np.array("long")),
    "course is short": lambda a: a.update(fit_best_cost=np.zeros(1)),
    "course is another": lambda a: a.update(fit_best_cost=np.zeros(3)),
    "median is text": lambda a: a.update(fit_median_cost=np.array(["a", "b", "c"])),
    "history is not a number": lambda a: a.update(jde_history=np.array([np.nan, np.nan, np.nan])),
    "a population of millions": lambda a: a.update({"jde_settings.population": np.array(10**15)}),
    "a population of another size": lambda a: a.update({"jde_settings.population": np.array(100_000)}),
    "a population without rows": lambda a: a.update(jde_population=np.array(0.5)),
    "many genes": lambda a: a.update(jde_population=np.zeros((6, 10_000))),
    "half floats": lambda a: a.update(jde_population=a["jde_population"].astype(np.float16)),
    "bounds are text": lambda a: a.update({"jde_settings.f_bounds": np.array(["a", "b"])}),
    "no settings": lambda a: [a.pop(name) for name in list(a) if "settings" in name],
}


@pytest.mark.parametrize("case", CHANGES)
def test_no_arrays_of_another_form_get_through(path: Path, case: str) -> None:
    rewritten(path, CHANGES[case])
    refused(path)


def test_an_edited_array_is_noticed(path: Path) -> None:
    arrays = dict(read_arrays(path))
    with np.load(path, allow_pickle=False) as file:
        digest = file["digest"]
    np.savez(path, **{**arrays, "jde_population": arrays["jde_population"] * 0.5}, digest=digest)  # type: ignore[arg-type]
    assert "its digest is another" in refused(path)


def member(header: str, body: bytes = b"") -> bytes:
    text = header.encode("latin1") + b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


@pytest.mark.parametrize(
    "content",
    [
        member("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}"),
        member("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, -1)}", b"0" * 8),
        member("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"\x80\x04K\x01."),
        member("{'descr': '<U1', 'fortran_order': False, 'shape': (1,)}", b"\xff\xff\xff\x7f"),
        member("{'descr': '<V8', 'fortran_order': False, 'shape': (1,)}", b"0" * 8),
        member("-" * 900),
        member("(" * 900),
        b"\x93NUMPY\x02\x00",
        b"",
    ],
)
def test_no_header_is_believed(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "checkpoint.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", content)
    refused(path)


def test_a_file_that_unpacks_to_gigabytes_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive, archive.open("a.npy", "w") as stream:
        for _ in range(300):
            stream.write(bytes(1 << 20))
    assert "too large" in refused(path)


def test_many_members_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(1000):
            archive.writestr(f"{k}.npy", b"")
    assert "too large" in refused(path)


@pytest.mark.parametrize("kind", ["pipe", "folder", "huge"])
def test_what_is_no_file_is_no_checkpoint(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "checkpoint.npz"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        with path.open("wb") as stream:
            stream.truncate(8 << 30)
    refused(path)


def test_an_encrypted_or_strangely_packed_member_is_refused(path: Path) -> None:
    whole = path.read_bytes()
    for flag in (b"\x01\x00", b"\x00\x00"):
        changed = bytearray(whole)
        at = whole.rindex(b"PK\x01\x02")
        changed[at + 8 : at + 10], changed[at + 10 : at + 12] = flag, b"\x63\x00"
        path.write_bytes(changed)
        refused(path)


def test_the_digest_is_of_names_shapes_and_numbers(tmp_path: Path) -> None:
    seen = set()
    for arrays in ({"a": np.zeros(4)}, {"b": np.zeros(4)}, {"a": np.zeros((2, 2))}, {"a": np.ones(4)}):
        write_arrays(tmp_path / "a.npz", arrays)
        with np.load(io.BytesIO((tmp_path / "a.npz").read_bytes()), allow_pickle=False) as file:
            seen.add(str(file["digest"]))
    assert len(seen) == 4
