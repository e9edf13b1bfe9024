"""Files that people give: regular ones of limited size are read, and the answer is one line."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from validation.experiment.gains import load_gains
from validation.files import reading
from validation.plants.profile import load_profile

LOADERS: dict[str, Callable[[Path], object]] = {
    "text": reading.read_text,
    "profile": load_profile,
    "gains": lambda path: load_gains("pid", str(path)),
}
"""Everything that reads a text which people give."""


def refused(load: Callable[[Path], object], path: Path) -> str:
    """The one line with which a file is refused; that takes no time."""
    began = time.perf_counter()
    with pytest.raises(ValueError, match=r"\S") as caught:
        load(path)
    assert time.perf_counter() - began < 5.0
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 1000 + len(str(path))
    return str(caught.value)


@pytest.fixture(params=LOADERS)
def load(request: pytest.FixtureRequest) -> Callable[[Path], object]:
    return LOADERS[request.param]


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "socket"])
def test_what_is_no_regular_file_is_neither_read_nor_waited_for(
    tmp_path: Path, load: Callable[[Path], object], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # addresses of sockets are short
    with socket.socket(socket.AF_UNIX) as one:
        one.bind("socket")
        os.mkfifo("pipe")
        Path("device").symlink_to("/dev/zero")
        Path("folder").mkdir()
        refused(load, tmp_path / kind)


def test_a_file_of_gigabytes_is_not_read(tmp_path: Path, load: Callable[[Path], object]) -> None:
    path = tmp_path / "great.toml"
    with path.open("wb") as stream:
        stream.truncate(4 << 30)
    assert "more than the" in refused(load, path)


def test_a_file_that_does_not_tell_its_size_is_not_read_without_end() -> None:
    path = Path("/proc/self/maps")
    if not path.is_file():
        pytest.skip("there is no /proc here")
    with pytest.raises(ValueError, match="more than the 100 bytes allowed"):
        reading.read_file(path, 100)


TOO_DEEP = {
    "tables": "a = " + "{b = " * 3000 + "1" + "}" * 3000,
    "lists": "a = " + "[" * 3000 + "]" * 3000,
    "dots": ".".join("a" * 4000) + " = 1",
}


@pytest.mark.parametrize("case", TOO_DEEP)
@pytest.mark.parametrize("loader", ["profile", "gains"])
def test_no_toml_is_nested_too_deep_or_takes_long(tmp_path: Path, loader: str, case: str) -> None:
    (tmp_path / "deep.toml").write_text(TOO_DEEP[case])
    assert "deep" in refused(LOADERS[loader], tmp_path / "deep.toml")


@pytest.mark.parametrize(
    "text", [f"a = {10**400}", f"a = {2**63}", f"a = -{2**63}0", "a = 1" + "0" * 5000]
)
def test_a_whole_number_of_toml_has_64_bits(tmp_path: Path, text: str) -> None:
    (tmp_path / "great.toml").write_text(text)
    refused(load_profile, tmp_path / "great.toml")


def test_a_byte_that_is_no_text_is_named_by_its_line(
    tmp_path: Path, load: Callable[[Path], object]
) -> None:
    (tmp_path / "mine.toml").write_bytes(b"a = 1\n\xff\n")
    assert "cannot be read as text; line 2" in refused(load, tmp_path / "mine.toml")
