"""Checkpoints: what was written comes back, and what is none is refused in one line."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ssmr.search.jde import Jde, JdeSettings
from validation.identify.search import Search

IDENTITY = {"model": "a", "seed": "b"}


def test_what_is_written_comes_back_and_what_is_damaged_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.npz"
    whole = Search(Jde(2, JdeSettings(6, 10), 1), IDENTITY)
    for _ in range(3):
        whole.jde.tell(np.sum(whole.jde.ask(), axis=1))
    whole.save(path)
    again = Search.load(path, IDENTITY)
    for one, other in zip(again.jde.state().values(), whole.jde.state().values(), strict=True):
        assert np.array_equal(one, other)
    written = path.read_bytes()
    for damaged in (
        b"",
        b"PK\x03\x04 rubbish",
        b"\x80\x04K\x01.",
        written[: len(written) // 2],
        written[:-1],
    ):
        path.write_bytes(damaged)
        refused(path)
    for arrays in ({"a": np.zeros(3)}, {"identity": np.array([{}], dtype=object)}):
        np.savez(path, **arrays)
        refused(path)


def test_a_checkpoint_with_a_number_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.npz"
    whole = Search(Jde(2, JdeSettings(6, 10), 1), IDENTITY)
    for _ in range(3):
        whole.jde.tell(np.sum(whole.jde.ask(), axis=1))
    whole.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    numbers = [name for name, values in arrays.items() if values.dtype.kind == "f"]
    assert len(numbers) > 8
    for name in numbers:
        damaged = np.array(arrays[name])
        damaged[(0,) * damaged.ndim] = np.nan
        np.savez(path, **{**arrays, name: damaged})
        refused(path)


def test_a_checkpoint_that_says_it_is_packed_in_another_way_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.npz"
    Search(Jde(2, JdeSettings(6, 10), 1), IDENTITY).save(path)
    whole = path.read_bytes()
    chance = np.random.default_rng(0)
    for method in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        for _ in range(300):
            damaged = bytearray(whole)
            for found in re.finditer(b"PK(?:\x01\x02|\x03\x04)", whole):
                is_local = found.group()[2] == 3
                damaged[found.start() + (8 if is_local else 10)] = method
                if is_local:
                    damaged[found.start() + 50 : found.start() + 90] = bytes(
                        chance.integers(40, size=40).tolist()
                    )
            path.write_bytes(damaged)
            refused(path)


def refused(path: Path) -> None:
    with pytest.raises(ValueError, match=r"checkpoint\.npz") as caught:
        Search.load(path, IDENTITY)
    assert "\n" not in str(caught.value)
