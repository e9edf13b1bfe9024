"""Checkpoints: what was written comes back, and whatever a file of that name holds, the answer is one line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.search.jde import Jde, JdeSettings
from validation.identify.search import CheckpointError, Search

IDENTITY = {"model": "a", "seed": "b"}


def search() -> Search:
    """A search that has gone through some generations."""
    found = Search(Jde(2, JdeSettings(6, 10), 1), IDENTITY)
    for _ in range(3):
        found.jde.tell(np.sum(found.jde.ask(), axis=1))
        found.remember()
    return found


@pytest.fixture
def path(tmp_path: Path) -> Path:
    found = tmp_path / "checkpoint.npz"
    search().save(found)
    return found


def test_what_is_written_comes_back(path: Path) -> None:
    again = Search.load(path, IDENTITY)
    whole = search()
    assert (again.best_cost, again.median_cost) == (whole.best_cost, whole.median_cost)
    for one, other in zip(again.jde.state().values(), whole.jde.state().values(), strict=True):
        assert np.array_equal(one, other)
    with np.load(path, allow_pickle=False) as file:  # it stays an .npz file that others can read
        assert set(file.files) > {"jde_population", "identity"}


@given(data=st.data())
def test_no_change_of_bytes_gets_through(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("changed") / "checkpoint.npz"
    search().save(path)
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.sampled_from([len(whole), len(whole) // 2, len(whole) - 1]))])
    try:
        again = Search.load(path, IDENTITY)
    except CheckpointError:
        return
    assert np.array_equal(again.jde.population, search().jde.population)  # a byte that decides nothing, such as a date


@pytest.mark.parametrize("what", ["empty", "rubbish", "a pickle", "other arrays", "objects", "pipe", "folder", "huge"])
def test_what_is_no_checkpoint_is_refused(tmp_path: Path, what: str) -> None:
    path = tmp_path / "checkpoint.npz"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "folder":
        path.mkdir()
    elif what == "huge":
        with path.open("wb") as stream:
            stream.truncate(8 << 30)
    elif what == "other arrays":
        np.savez(path, a=np.zeros(3))
    elif what == "objects":
        np.savez(path, identity=np.array([{}], dtype=object))
    else:
        path.write_bytes({"empty": b"", "rubbish": b"PK\x03\x04 rubbish", "a pickle": b"\x80\x04K\x01."}[what])
    with pytest.raises(CheckpointError, match=r"checkpoint\.npz") as caught:
        Search.load(path, IDENTITY)
    assert "\n" not in str(caught.value)
