"""Everything that the command lines of the programs share: options, exit status, one-line errors, progress, tables.

A program's `__main__` declares its options as a frozen dataclass, in groups that are dataclasses too (a group's field name
is its heading in the help text), and hands the function that takes them to `run`.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import inspect
import io
import itertools
import logging
import math
import re
import sys
import time
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

import tyro
from rich.console import Console
from rich.text import Text
from tyro.constructors import PrimitiveConstructorSpec

from ssmr.errors import SsmrError
from validation import store
from validation.progress import Progress, Report
from validation.show.tables import Grid, rich_table
from validation.words import one_line

EXIT_FAILED_RUN = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130

LOG_EVERY_S = 5.0
"""Time between two lines of progress where standard error is no terminal [s]."""

T = TypeVar("T")


class UserError(ValueError):
    """The user asked for something that cannot be; the message is one line that says what was wrong and what is right."""


# ------------------------------------------------------------------------------------------- options
def option(
    name: str | None = None, *, metavar: str | None = None, default: str | None = None, help: str | None = None
) -> object:
    """Return what to annotate an option with.

    Args:
        name: the option's name where the field cannot have it, such as `from`.
        metavar: what stands for its value in the help text.
        default: the default in words, where the value itself does not say it.
        help: the help text; else the docstring below the field.
    """
    hint = None if default is None else f"(default: {default})"
    return tyro.conf.arg(name=name, metavar=metavar, help=help, help_behavior_hint=hint, prefix_name=False)


def one_of(names: Iterable[str]) -> Any:
    """Return what to annotate an argument with that is one of these names: the help lists them, others are refused."""
    return tyro.conf.arg(constructor=tyro.extras.literal_type_from_choices(names), prefix_name=False)


def parsed(parse: Callable[[str], T], metavar: str, write: Callable[[T], str] = str) -> object:
    """Return what to annotate an option with whose text `parse` reads; a `ValueError` of it is the user's mistake."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: parse(texts[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: [write(value)],
    )


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _comma_names(text: str) -> tuple[str, ...]:
    found = tuple(_parts(text))
    if len(set(found)) != len(found):
        raise UserError(f"a name stands twice in '{text}'")
    return found


def _comma_numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, _parts(text)))
    except ValueError as error:
        raise UserError(f"'{text}' is no list of numbers such as 2,6,30,60") from error
    if any(not 0.0 < n < math.inf for n in numbers) or any(b <= a for a, b in pairwise(numbers)):
        raise UserError(f"'{text}' must be positive numbers that increase, such as 2,6,30,60")
    return numbers


def _comma_pairs(text: str, read: Callable[[str], T], form: str) -> dict[str, T]:
    """Return NAME=SOMETHING,... as a dictionary.

    Raises:
        UserError: a part has another form, or a name stands twice.
    """
    found: dict[str, T] = {}
    for part in _parts(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        try:
            if not equals or not name or name in found:
                raise ValueError
            found[name] = read(value)
        except ValueError as error:
            raise UserError(f"'{part}' must be {form}, each name once") from error
    return found


def _finite(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UserError(f"'{text}' must be a number")
    return number


def _span(text: str) -> tuple[float, float]:
    low, high = text.split(":")
    return float(low), float(high)


def read_values(text: str) -> dict[str, float]:
    """Return NAME=NUMBER,... as a dictionary.

    Raises:
        UserError: a part has another form, or a name stands twice.
    """
    return _comma_pairs(text, _finite, "NAME=NUMBER such as friction=0.4")


def _whole(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = least - 1
        if number < least:
            raise UserError(f"'{text}' must be a whole number from {least} on")
        return number

    return parse


Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(prefix_name=False, help_behavior_hint="")]
"""An option without a value, off unless given."""
Names = Annotated[tuple[str, ...], parsed(_comma_names, "A,B,...", ",".join)]
"""Comma-separated names, none twice. The function that gets them knows which there are."""
Numbers = Annotated[tuple[float, ...], parsed(_comma_numbers, "X,Y,...", lambda v: ",".join(f"{x:g}" for x in v))]
"""Comma-separated positive numbers that increase."""
Values = Annotated[
    Mapping[str, float], parsed(read_values, "NAME=X,...", lambda v: ",".join(f"{k}={x:g}" for k, x in v.items()))
]
"""NAME=NUMBER,... as a mapping."""
Bounds = Annotated[
    Mapping[str, tuple[float, float]],
    parsed(
        lambda text: _comma_pairs(text, _span, "NAME=LOW:HIGH such as friction=0.2:0.8"),
        "NAME=LOW:HIGH,...",
        lambda v: ",".join(f"{k}={a:g}:{b:g}" for k, (a, b) in v.items()),
    ),
]
"""NAME=LOW:HIGH,... as a mapping to pairs."""
Number = Annotated[float | None, parsed(_finite, "X", lambda v: "" if v is None else f"{v:g}")]
"""A finite number, or None where the option is not given."""
Count = Annotated[int | None, parsed(_whole(1), "N", lambda v: "" if v is None else str(v))]
"""A whole number from 1 on, or None where the option is not given."""
Seed = Annotated[int, parsed(_whole(0), "N"), option(help="Seed of everything random. Equal seeds give equal results.")]
"""The seed of a program, not negative."""
Workers = Annotated[
    int | None,
    parsed(_whole(1), "N", lambda v: "" if v is None else str(v)),
    option(default="all processors", help="Threads that compute. The result does not depend on how many there are."),
]
"""The number of threads; None for as many as there are processors."""
View = Annotated[Flag, option(help="Open the recording in the rerun viewer afterwards.", default="off")]
NoRerun = Annotated[Flag, option(help="Do not write the rerun recording (.rrd).", default="off")]


def profile_option(default: str | None = None) -> object:
    """Return the annotation of `--profile`; `default` says in words which profile is taken without it."""
    return option(metavar="PROFILE", default=default, help="Name of a shipped profile, or path of a profile (.toml).")


def out_option(default: str) -> object:
    """Return the annotation of `--out`; `default` is the folder without it, such as runs/compare/SOURCE."""
    return option(metavar="DIR", default=f"the folder {default}", help="Folder that the files are written to.")


@dataclass(frozen=True)
class Run:
    """Options of every program that computes with random numbers."""

    seed: Seed = 0
    workers: Workers = None


@dataclass(frozen=True)
class Output:
    """Options for what is written and shown by a program that makes a recording; each program says its own folder."""

    out: Path | None = None
    view: View = False
    no_rerun: NoRerun = False

    def check(self) -> None:
        """Refuse to show a recording that is not written."""
        if self.view and self.no_rerun:
            raise UserError("--view shows the rerun recording; leave out --no-rerun")

    def show(self, recording: Path) -> None:
        """Open the recording in the viewer if that is asked for."""
        if self.view:
            from validation.show.viewer import open_viewer

            open_viewer(recording)


# ------------------------------------------------------------------------------------------- mistakes
@contextlib.contextmanager
def mistakes_are_users() -> Iterator[None]:
    """Within, a `ValueError` is the user's mistake: names, numbers and files are being read, nothing is computed yet."""
    try:
        yield
    except UserError:
        raise
    except ValueError as error:
        raise UserError(one_line(error)) from error


def output_folder(path: Path) -> Path:
    """Make the folder that results go to.

    Raises:
        UserError: it cannot be made or written.
    """
    try:
        return store.make_folder(path)
    except ValueError as error:
        raise UserError(f"--out {error}") from error


# ------------------------------------------------------------------------------------------- progress and reports
@contextlib.contextmanager
def shown(title: str) -> Iterator[Report]:
    """Within, a progress bar on standard error; yield the callback that moves it.

    Where standard error is no terminal, a line every few seconds says the same: how much is done, what, and the time left.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    began = last = time.perf_counter()
    first: float | None = None  # steps that were done before, where work is resumed
    console = Console(stderr=True)
    columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    words = TextColumn("{task.description}", markup=False)
    bar = Bar(words, *columns, console=console, transient=True, disable=not console.is_terminal)

    def show(now: Progress) -> None:
        nonlocal last, first
        first = now.done if first is None else first
        bar.update(task, completed=now.done, total=now.total, description=one_line(f"{title}: {now.text}"))
        clock = time.perf_counter()
        if bar.disable and clock - last > LOG_EVERY_S and now.done > first:
            last = clock
            left = (now.total - now.done) / (now.done - first) * (clock - began)
            _say(f"{title}: {now.done:.0f} of {now.total:.0f}, {now.text}; {left:.0f} s left")

    with bar:
        task = bar.add_task(one_line(title), total=None)
        yield show


def report_console() -> Console:
    """Return standard output for tables, wide enough for them where it is no terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=110)


class Reportable(Protocol):
    """A finding that has tables and sentences below them."""

    def grids(self) -> Sequence[Grid]:
        """Return its tables."""

    def notes(self) -> Sequence[str]:
        """Return its sentences."""


def report_result(result: Reportable, written: Iterable[Path] = ()) -> None:
    """Print a result's tables and notes, and the paths of what was written, on standard output."""
    console = report_console()
    for grid in result.grids():
        console.print(rich_table(grid))
    for note in result.notes():
        console.print(Text("\n".join(map(one_line, note.splitlines()))))
    if files := ", ".join(map(one_line, written)):
        console.print(Text(f"written: {files}"), soft_wrap=True)


def warn(text: str) -> None:
    """Print one line on standard error."""
    _say(f"warning: {text}")


def _say(text: str) -> None:
    print(one_line(text), file=sys.stderr, flush=True)


# ------------------------------------------------------------------------------------------- running a program
def run(
    main: Callable[..., Any] | Mapping[str, Callable[..., Any]], program: str, arguments: Sequence[str] | None = None
) -> None:
    """Parse a command line, call the program, and leave with the exit status that says how it went.

    Args:
        main: a function that takes one dataclass of options, or such functions by the name of their subcommand. The
            function's docstring is the description in the help text.
        program: how usage texts call the program, such as `python -m validation.compare`.
        arguments: the command line; by default that of this process.
    """
    from rich.logging import RichHandler

    handler = RichHandler(console=Console(stderr=True), show_path=False, show_time=False)
    logging.basicConfig(format="%(message)s", handlers=[handler])
    logging.getLogger("validation").setLevel(logging.INFO)  # of other packages only warnings
    gc.set_threshold(50_000, 20, 100)  # imports make many objects that stay, and Python would look through them all the time
    try:
        called, options = _parse(main, program, arguments)
        called(options)
        return
    except UserError as error:
        said, status = f"error: {error}", EXIT_USER_ERROR
    except SsmrError as error:
        said, status = f"run failed: {error}", EXIT_FAILED_RUN
    except MemoryError:
        said, status = "run failed: there is not enough memory", EXIT_FAILED_RUN
    except OSError as error:
        where = f" ({error.filename})" if error.filename else ""
        said, status = f"run failed: {error.strerror or error}{where}; what was written before is whole", EXIT_FAILED_RUN
    except KeyboardInterrupt:
        said, status = "interrupted", EXIT_INTERRUPTED
    _say(said)
    sys.exit(status)


def _parse(main: Any, program: str, arguments: Sequence[str] | None) -> tuple[Callable[[Any], Any], Any]:
    """Return the function to call and the options to call it with.

    Raises:
        UserError: the command line says something that cannot be.
        SystemExit: it asked for help.
    """
    said = io.StringIO()
    read = functools.partial(tyro.cli, prog=program, args=arguments, config=(tyro.conf.DisallowNone,))
    try:
        with contextlib.redirect_stderr(said):
            if isinstance(main, Mapping):
                mains = {_options_of(function): function for function in main.values()}
                kinds = [
                    Annotated[kind, tyro.conf.subcommand(name, prefix_name=False, description=inspect.getdoc(function))]
                    for name, (kind, function) in zip(main, mains.items(), strict=True)
                ]
                options = read(typing.Union[tuple(kinds)])  # noqa: UP007 - of a list that is known at run time only
                return mains[type(options)], options
            if (kind := _options_of(main)) is not None:
                return main, read(kind, description=inspect.getdoc(main))
    except SystemExit as left:
        if left.code:
            raise UserError(_mistake_in(said.getvalue())) from None
        raise
    return lambda _: tyro.cli(main, prog=program, args=arguments), None


def _mistake_in(box: str) -> str:
    """Return the message in the box that tyro draws around it, in one line."""
    lines = [line.strip("│|+ ") for line in box.strip().splitlines()[1:]]
    rule = [set(line) <= {"─", "-"} for line in lines]
    start = rule.index(False) if False in rule else 0
    said = itertools.takewhile(lambda line: not set(line) <= {"─", "-"} or not line, lines[start:])
    text = one_line(" ".join(said))
    return re.sub(r"^Error parsing ([^ :]+):", r"\1:", text) or "the command line cannot be read; see --help"


def _options_of(main: Callable[..., Any]) -> Any:
    """Return the dataclass that a program takes; None where its arguments are the options themselves."""
    names = list(inspect.signature(main).parameters) if inspect.isfunction(main) else []
    kind = typing.get_type_hints(main).get(names[0]) if len(names) == 1 else None
    return kind if is_dataclass(kind) else None


def leave_out(package: str) -> None:
    """Let this process do without a package that others only look for: rerun's pyarrow would load all of pandas."""

    class Finder:
        """An importer that does not find the package."""

        @staticmethod
        def find_spec(name: str, path: object = None, target: object = None) -> None:
            """Refuse the package and leave all others to the next importer."""
            if name == package:
                raise ModuleNotFoundError(f"{package} is left out of this program", name=package)

    sys.meta_path.insert(0, Finder)
