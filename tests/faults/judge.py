"""The one way of judging: what a call or a program left behind, and which promises that breaks."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import tomllib
import unicodedata
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

LONGEST_ERROR = 700
"""Length of an error message: a list of names is long, an array that is printed whole is longer."""
LONGEST_WAIT = 20.0
"""Time after which something that should be quick hangs [s]."""
FAULT = 70
"""Status of a program that has a fault of its own, and says so."""
USUAL = (0, 1, 2)
"""Statuses of a program that nobody disturbed."""

CLASSES = (
    "traceback", "hang", "died", "escape", "non-finite", "damaged file", "left over", "wrote on a mistake", "false status",
    "false claim", "unclear line", "stray warning", "differs",
)  # fmt: skip
"""Classes of faults, the worst first."""

_HARMFUL = {"Cc", "Cf", "Cs", "Zl", "Zp"}
_LAST_WORDS = ("error: ", "run failed: ", "interrupted", "ended by ")
_KNOWN_LINES = re.compile(
    r"^(warning: |INFO |WARNING |ERROR | {9}|.*: \d+ of \d+, |no folder belongs to this user alone"
    r"|Could not save font_manager cache|mkdir -p failed for path|Matplotlib created a temporary cache)"
)  # lines of progress, of the log, and of Matplotlib where it cannot write
_NUMBER_WORD = re.compile(r"(?<![\w./'-])[-+]?(nan|inf)(?![\w./'-])", re.IGNORECASE)
_WRITTEN = re.compile(r"^written: (.+)$", re.MULTILINE)


@dataclasses.dataclass
class Outcome:
    """What is known of a call or a program that has ended."""

    what: str
    """Description of the case, in one line."""
    status: int | None = 0
    """Exit status; None if it had to be stopped."""
    stdout: str = ""
    stderr: str = ""
    folder: Path | None = None
    """Where its files are."""
    before: frozenset[str] = frozenset()
    """Files that were there before, relative to the folder."""
    foreign: str = ""
    """Text that it was given; a number word in it may come back."""
    hung: bool = False
    """Whether it took too long."""
    weight: int = 1
    """Number of inputs, kills or signals that it stands for."""
    faults: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    """Faults that whoever ran it has seen already: class, text."""

    def fault(self, kind: str, text: object) -> None:
        """Note what should not have been."""
        assert kind in CLASSES
        self.faults.append((kind, visible(text)[:400]))


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What is kept of a case."""

    what: str
    accepted: bool
    weight: int
    faults: tuple[tuple[str, str], ...]


def visible(text: object) -> str:
    """Return a text in one line in which nothing is hidden."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in str(text).replace("\n", " ⏎ "))


def finite(value: Any, depth: int = 0) -> bool:
    """Return whether all numbers in a value are finite, or a limit that is off (infinite by design in dataclasses)."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind not in "fc" or bool(np.isfinite(value).all())
    if isinstance(value, float):
        return not math.isnan(value)
    if depth > 4:
        return True
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return all(finite(getattr(value, f.name), depth + 1) for f in dataclasses.fields(value))
    if isinstance(value, dict):
        return all(finite(v, depth + 1) for v in value.values())
    if isinstance(value, tuple | list):
        return all(finite(v, depth + 1) for v in value[:1000])
    return True


def judge(outcome: Outcome, allowed: Sequence[int] = USUAL) -> Verdict:
    """Return the verdict on an outcome: every promise that it breaks, by class."""
    _judge_status(outcome, allowed)
    for look in (_judge_lines, _judge_output, _judge_claims, _judge_files):
        look(outcome)
    return Verdict(outcome.what, outcome.status == 0, outcome.weight, tuple(dict.fromkeys(outcome.faults)))


def _judge_status(outcome: Outcome, allowed: Sequence[int]) -> None:
    """Find statuses that are not true."""
    status, said = outcome.status, outcome.stderr.strip()
    if "Traceback (most recent call last)" in outcome.stderr + outcome.stdout or status == FAULT:
        outcome.fault("traceback", said[-300:])
    elif outcome.hung or status is None:
        outcome.fault("hang", "it had to be stopped")
    elif status not in allowed:
        outcome.fault("died" if status < 0 else "false status", f"status {status}, not one of {allowed}: {said[-300:]}")
    elif not status and said.splitlines()[-1:] and said.splitlines()[-1].startswith(("error: ", "run failed: ")):
        outcome.fault("false status", f"status 0, and yet: {said[-300:]}")


def _judge_lines(outcome: Outcome) -> None:
    """Find what standard error says beside the one line that says how it ended, and such a line that nobody understands."""
    said = [line for line in outcome.stderr.splitlines() if line.strip()]
    if "Warning: " in outcome.stderr:
        outcome.fault("stray warning", outcome.stderr)
    elif outcome.status and outcome.status > 0 and outcome.status != FAULT and "traceback" not in dict(outcome.faults):
        last = said[-1] if said else ""
        if not last.startswith(_LAST_WORDS) or len(last) > LONGEST_ERROR:
            outcome.fault("unclear line", f"status {outcome.status}: {outcome.stderr!r}")
        elif unknown := [line for line in said[:-1] if not _KNOWN_LINES.match(line)]:
            outcome.fault("unclear line", f"not one line: {' '.join(unknown)}")


def _judge_output(outcome: Outcome) -> None:
    """Find characters that work on a terminal, and numbers that are none."""
    hidden = {c for c in outcome.stdout + outcome.stderr if c != "\n" and unicodedata.category(c) in _HARMFUL}
    if hidden and "traceback" not in dict(outcome.faults):
        outcome.fault("escape", f"{sorted(map(ascii, hidden))} in the output")
    for found in _NUMBER_WORD.finditer(outcome.stdout) if outcome.status == 0 else ():
        if found[1].lower() not in outcome.foreign.lower():
            outcome.fault("non-finite", f"'{found[0]}' in the tables")
            break


def _judge_claims(outcome: Outcome) -> None:
    """Find paths that are claimed to be written, and are not there."""
    for line in _WRITTEN.findall(outcome.stdout) if outcome.folder is not None and outcome.status == 0 else ():
        paths = [outcome.folder / text for text in line.split(", ")]
        if "\\" not in line and not all(path.exists() for path in paths):
            outcome.fault("false claim", f"not there: {line}")


def _judge_files(outcome: Outcome) -> None:
    """Find files that are left over, that should not be there, or are not whole."""
    if outcome.folder is None:
        return
    for name in sorted(files_in(outcome.folder)):
        if ".part" in Path(name).name:
            outcome.fault("left over", name)
        elif outcome.status == 2 and name not in outcome.before:
            outcome.fault("wrote on a mistake", name)
        elif name not in outcome.before and (why := why_damaged(outcome.folder / name)):
            outcome.fault("damaged file" if "finite" not in why else "non-finite", f"{name}: {why}")


def files_in(folder: Path) -> Iterable[str]:
    """Return the names of the files of a folder, relative to it; links and devices are not followed."""
    return [str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and not p.is_symlink()]


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not finite")


def why_damaged(path: Path) -> str:
    """Return why a file is not whole; an empty text if it is, or if its kind is not known."""
    try:
        data = path.read_bytes()
        if path.suffix == ".json":
            json.loads(data, parse_constant=_refuse)
        elif path.suffix == ".toml":
            tomllib.loads(data.decode())
        elif path.suffix == ".png":
            return "" if data.startswith(b"\x89PNG") and b"IEND" in data[-12:] else "not a whole PNG"
        elif path.suffix == ".npz":
            return "" if zipfile.ZipFile(path).testzip() is None else "not a whole archive"
        elif path.suffix == ".rrd":
            return "" if data.startswith(b"RRF2") and len(data) > 1000 else "not a whole recording"
        elif path.suffix == ".mcap":
            return "" if data.endswith(b"\x89MCAP0\r\n") else "not a whole MCAP file"
        elif path.suffix in (".md", ".html", ".csv", ".tum"):
            text = data.decode()
            if hidden := {c for c in text if c not in "\n\r\t" and unicodedata.category(c) in {"Cc", "Cs"}}:
                return f"{sorted(map(ascii, hidden))} in it"
            return "" if text.endswith("\n") or path.suffix == ".html" else "its last line is cut off"
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        return str(error) or type(error).__name__
    return ""
