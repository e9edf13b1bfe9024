"""Damaged and hostile bags: one line and exit status 2, or a sound result.

Soon, and in little memory.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from backports import zstd

from tests import child_work
from tests.bag_factory import KINDS, PACKED_KINDS, circle, write
from tests.conftest import exit_status, processor_time
from validation.files import bags, guarded
from validation.recordings import PROGRAM

pytestmark = pytest.mark.usefixtures("with_children")

ALL_KINDS = (*(kind for kind in KINDS if kind != "mcap folder"), *PACKED_KINDS)
LONGEST = 20.0
"""Time of the processor in which every small bag is answered [s]."""
MUTATIONS = 100
"""Mutations of each kind of bag in the long test."""


def answered(path: Path, capsys: pytest.CaptureFixture[str]) -> int:
    """The exit status for a bag, which is told soon and in one line where it is refused."""
    capsys.readouterr()
    began = processor_time()
    status = exit_status(PROGRAM, "info", str(path))
    assert processor_time() - began < LONGEST
    printed = capsys.readouterr()
    assert status in (0, 2), printed.err
    if status == 2:
        assert printed.err.startswith(f"error: {path}")
        assert printed.err.count("\n") == 1
        assert not printed.out
    else:
        assert "nan" not in printed.out
    return status


def data_of(bag: Path) -> Path:
    """The file of a bag that has its messages."""
    return (
        next(file for file in bag.iterdir() if file.name != "metadata.yaml")
        if bag.is_dir()
        else bag
    )


def mutated(whole: bytes, chance: np.random.Generator) -> bytes:
    """Bytes of which some are others, cut short, or with a part of them zero or twice."""
    data = bytearray(whole)
    start = int(chance.integers(len(data)))
    length = int(chance.integers(1, 2000))
    way = chance.integers(4)
    if way == 0:
        del data[start:]
    elif way == 1:
        data[start : start + length] = bytes(len(data[start : start + length]))
    elif way == 2:
        data[start:start] = data[start : start + length]
    else:
        for k in chance.integers(len(data), size=chance.integers(1, 9)):
            data[k] = chance.integers(256)
    return bytes(data)


def damage(bag: Path, seed: int, many: int, capsys: pytest.CaptureFixture[str]) -> list[int]:
    """Exit statuses for a bag with data damaged in many ways, every fifth time also metadata."""
    files = [data_of(bag)] * 4 + ([bag / "metadata.yaml"] if bag.is_dir() else [])
    statuses = []
    for k in range(many):
        file = files[k % len(files)]
        whole = file.read_bytes()
        file.write_bytes(mutated(whole, np.random.default_rng([seed, k])))
        statuses.append(answered(bag, capsys))
        file.write_bytes(whole)
    return statuses


@pytest.mark.parametrize("kind", PACKED_KINDS)
def test_packed_bags_are_read(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert answered(write(tmp_path, kind, circle()), capsys) == 0


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_a_damaged_bag_is_read_or_refused_in_one_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(tmp_path, kind, circle(20))
    whole = data_of(bag).read_bytes()
    data_of(bag).write_bytes(whole[: len(whole) // 3])
    assert answered(bag, capsys) == 2
    data_of(bag).write_bytes(whole)
    damage(bag, 1, 2, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL_KINDS)
def test_many_damaged_bags(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    statuses = damage(write(tmp_path, kind, circle(20)), ALL_KINDS.index(kind), MUTATIONS, capsys)
    with capsys.disabled():
        print(f"{kind}: {statuses.count(0)} read, {statuses.count(2)} refused")
    assert 2 in statuses


def test_metadata_that_doubles_itself_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bags, "_SECONDS", 0.5)
    bag = write(tmp_path, "sqlite", circle(20))
    merges = "".join(f"b{k}: &b{k}\n  <<: [*b{k - 1}, *b{k - 1}]\n" for k in range(1, 40))
    metadata = bag / "metadata.yaml"
    metadata.write_text(f"b0: &b0 {{k: 1}}\n{merges}{metadata.read_text()}")
    assert answered(bag, capsys) == 2


@pytest.mark.parametrize("count", ["1" + "0" * 30, str(2**62), "-5", ".inf", "[]"])
def test_metadata_that_counts_what_cannot_be_is_refused_or_passed_over(
    count: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(tmp_path, "sqlite", circle(20))
    metadata = bag / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("message_count: 20", f"message_count: {count}")
    )
    answered(bag, capsys)


def test_a_bag_that_unpacks_to_gigabytes_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zeros are 30 000 times as large as what zstd makes of them: a bag and a message."""
    monkeypatch.setattr(bags, "_MEMORY", 1 << 30)
    (tmp_path / "unpacked").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "unpacked"))
    files = write(tmp_path, "sqlite file", circle(20), "files")
    zeros = zstd.compress(bytes(1 << 20)) * 2048
    data_of(files).write_bytes(zeros)
    assert answered(files, capsys) == 2
    messages = write(tmp_path, "sqlite messages", circle(20), "messages")
    with sqlite3.connect(data_of(messages)) as stored:
        stored.execute("UPDATE messages SET data = ?", (zeros,))
    assert answered(messages, capsys) == 2
    assert not list((tmp_path / "unpacked").iterdir())


def test_a_fault_without_words_has_its_name() -> None:
    with pytest.raises(ValueError, match="LookupError"):
        guarded.ask(child_work.fail, [], (60.0, 1 << 30, 0))
