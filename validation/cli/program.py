"""A program is a function with options that gives a report.

It is declared once, and called from Python and from the command line.
"""

from __future__ import annotations

import contextlib
import inspect
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Generic, ParamSpec, TypeVar

import tyro
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from ssmr.parameters import MOST_SEED, require_within
from validation import output
from validation.cli.config import config_of, options_in, read_result
from validation.cli.options import AnyPath, Options, kinds_of, meanings_of, words_of
from validation.cli.process import run_command, say_line
from validation.files.reading import opened
from validation.output import PICTURES, make_visible, one_line
from validation.report.report import INTERRUPTED, Report
from validation.report.table import print_tables
from validation.workers import require_address

P = ParamSpec("P")
Opts = TypeVar("Opts", bound=Options)
R = TypeVar("R", bound=Report)
_MOST_WORKERS = 4096
"""Greatest number of threads."""
_LOG_EVERY_S = 5.0
"""Time between two lines of progress where standard error is no terminal [s]."""
_TELLS_TIME = 10.0
"""Progress from which the time that is left is shown [%]."""
_ENDLESS = 10_000
"""Width of an output that is no terminal."""
_CHECKPOINT = b"identity.npy"
"""Name of the first array of a checkpoint."""
_HEAD = 64
"""Length of the beginning of a checkpoint, in which that name stands [bytes]."""


@dataclass(frozen=True, kw_only=True)
class Common(Options):
    """Options that every program has."""

    seed: int = 0
    """Seed of everything random. Equal seeds give equal results."""
    workers: int | str | None = None
    """Threads that compute, all processors if not given; or the address of a dask scheduler. The
    result does not depend on who computes."""
    out: AnyPath = None
    """Folder for the files; runs/PROGRAM/... if not given. A file that ends in .png, .pdf or .svg
    is the picture alone, and the other files are in runs/PROGRAM/... ."""
    plain: bool = False
    """Draw the picture for a paper: as wide as two columns, with letters of 7 points, and without
    title, notes and the line on how it was made."""
    overwrite: bool = False
    """Replace files that this program did not write; its own of an earlier run it always
    replaces."""
    config: AnyPath = None
    """JSON file of a run of this program: its options hold where no others are given."""
    progress: tyro.conf.Suppress[output.Progressing] = output.ignore_progress
    """Called as the work goes on."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range."""
        super().__post_init__()
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)
        if isinstance(self.workers, str) and self.workers.isdecimal():
            # of a number or a text, tyro gives the text
            object.__setattr__(self, "workers", int(self.workers))
        if isinstance(self.workers, str):
            require_address(self.workers)
        else:
            require_within(self, ("workers",), 1, _MOST_WORKERS, whole=True)

    def folder(self) -> Path:
        """Return the folder that files are written to where `out` names none."""
        return Path("runs") / type(self).__name__.lower()

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        name = self.folder().parts[1]
        return tuple(f"{name}.{ending}" for ending in ("json", "png", "md", "rrd"))


@dataclass(frozen=True, kw_only=True)
class Filmed(Common):
    """Options of a program whose robots can be seen in motion."""

    workers: int | None = None
    """Threads that compute; all processors if not given. The result does not depend on how many
    there are."""
    view: bool = False
    """Open the recording in the rerun viewer afterwards."""
    no_rerun: bool = False
    """Do not write the rerun recording (.rrd)."""
    no_picture: bool = False
    """Do not draw the picture (.png)."""


class _Words(str):
    """A type in a signature, in words for people: without modules and quotation marks."""

    def __new__(cls, kind: Any) -> _Words:
        """Return the words of a type."""
        return super().__new__(cls, words_of(kind))

    __repr__ = str.__str__


class Program(Generic[P, R]):
    """A program: called with its options it returns its report.

    `main` runs it from the command line.
    """

    def __init__(self, options: Any, function: Callable[[Any], R]) -> None:
        """Keep the dataclass of the options and the function that takes it."""
        self.options = options
        self.function = function
        self.__name__ = function.__name__
        self.__module__ = function.__module__
        kinds = kinds_of(options)
        taken = inspect.signature(options)
        parameters = [p.replace(annotation=_Words(kinds[n])) for n, p in taken.parameters.items()]
        returned = _Words(inspect.get_annotations(function)["return"])
        self.__signature__ = taken.replace(parameters=parameters, return_annotation=returned)

    @property
    def __doc__(self) -> str:  # type: ignore[override]
        """Text of the function, and what each option means."""
        lines = [inspect.getdoc(self.function) or "", "", "Options:"]
        meanings = meanings_of(self.options)
        lines += [f"    {name}: {meanings[name]}" for name in self.__signature__.parameters]
        return "\n".join(lines)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return the report of a run with these options, or those of the file `config`."""
        given = inspect.signature(self.options).bind_partial(*args, **kwargs).arguments
        path = given.get("config")
        kept = {} if path is None else options_in(path, self.__name__, self.options)
        return self.run(self.options(**{**kept, **given}))

    def run(self, options: Any) -> R:
        """Return the report of a run with these options, which it then holds."""
        report = self.function(options)
        return replace(report, config=config_of(self.__name__, options))

    @property
    def command(self) -> Callable[[Any], None]:
        """The function behind the command line.

        It shows progress, prints, saves and says what went wrong.
        """

        def main(options: Any) -> None:
            if isinstance(options, Filmed):
                _require_shown(options)
            picture = None
            if options.out is not None and Path(options.out).suffix.lower() in PICTURES:
                picture = Path(options.out)
                require_writable(picture.parent)
                require_apart(options, picture.parent, [picture.name])
                options = replace(options, out=None)
            folder = Path(options.out or options.folder())
            require_writable(folder)
            require_apart(options, folder, options.writes())
            with _progress_bar(self.__name__) as show:
                report = self.run(replace(options, progress=show, out=folder))
            _finish_program(report, options, output.make_folder(folder), picture)

        main.__doc__ = inspect.getdoc(self.function)
        main.__name__ = self.__name__
        main.__annotations__ = {"options": Annotated[self.options, tyro.conf.arg(name="")]}
        return main

    def main(self) -> None:
        """Run the program with the command line of this process, and leave with an exit status."""
        run_command(self, f"python -m validation.{self.__name__}")


def make_program(options: Callable[P, Opts]) -> Callable[[Callable[[Opts], R]], Program[P, R]]:
    """Return the decorator that makes a function of these options a program."""
    return lambda function: Program(options, function)


def _require_shown(options: Filmed) -> None:
    """Raise a ValueError for a recording that is shown but not written, or needs rerun."""
    if options.view and options.no_rerun:
        raise ValueError("--view shows the rerun recording; leave out --no-rerun")
    if not options.no_rerun and find_spec("rerun") is None:
        raise ValueError(
            "the recording needs the package rerun-sdk, which is missing: "
            "install it, or add --no-rerun"
        )


def _finish_program(
    report: Report, options: Common, folder: Path, picture: Path | None = None
) -> None:
    """Save and print a report, show its recording, and raise its failure.

    `picture` is the file for its picture alone, where the user names one.
    """
    film = options if isinstance(options, Filmed) else None
    # tables first: pictures take longer than many a run
    report_result(report)
    written = report.save(
        folder,
        recording=film is None or not film.no_rerun,
        picture=film is None or not film.no_picture,
    )
    if picture is not None or options.plain:
        drawn = picture or folder / f"{report.program}.png"
        report.save_picture(drawn, plain=options.plain)
        written = [*dict.fromkeys([*written, drawn])]
    _report_written(written)
    if film is not None and film.view:
        from validation.report.viewer import open_viewer

        open_viewer(folder / f"{report.program}.rrd")
    if report.failure is not None:
        raise report.failure
    if report.status == INTERRUPTED:
        raise KeyboardInterrupt


# --- folders and files that users name ---


def require_writable(folder: Path) -> None:
    """Raise a ValueError for a folder that could not be made or written, before hours of work."""
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise ValueError(
            f"--out {folder}: {nearest} is no folder that can be written; name another"
        )


def require_apart(options: Any, folder: Path, names: Iterable[str]) -> None:
    """Refuse to write over a file that is read, or that is not ours in a folder that is named.

    A file is ours if a JSON file of ours is there that names it, or if it is a checkpoint.

    Raises:
        ValueError: there is such a file among the `names` of files to write, and no `overwrite`.
    """
    if options.overwrite:
        return
    texts: list[Any] = []
    for f in fields(options):
        value = getattr(options, f.name)
        texts += value if isinstance(value, tuple | list) else (value,)
    # a ring of links is itself
    read = [Path(os.path.realpath(text)) for text in texts if isinstance(text, str | Path)]
    there = [path for path in (folder / name for name in names) if os.path.lexists(path)]
    ours = {path.name for path in there} if options.out is None else _ours_among(there)
    for path in there:
        if path.name not in ours or Path(os.path.realpath(path)) in read:
            raise ValueError(
                f"--out {folder} has a {path.name} already, which would be lost; "
                "name another, or add --overwrite"
            )


def _ours_among(there: Sequence[Path]) -> set[str]:
    """Return the names of files of our programs, and of the files that these name."""
    ours = set()
    for path in there:
        # a file that cannot be read so is not ours
        with contextlib.suppress(ValueError, TypeError):
            if path.suffix == ".npz":
                with opened(path) as stream:
                    ours |= {path.name} if _CHECKPOINT in stream.read(_HEAD) else set()
            elif path.suffix == ".json":
                # 2.0 named none
                every = [other.name for other in there]
                ours |= {path.name, *read_result(path).get("files", every)}
    return ours


# --- output of a program ---


@contextlib.contextmanager
def _progress_bar(title: str) -> Iterator[output.Progressing]:
    """Within, a progress bar on standard error; yield the callback that moves it.

    Where standard error is no terminal, a line every few seconds says the same.
    """
    from rich.progress import (
        BarColumn,
        Progress,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )

    class Remaining(TimeRemainingColumn):
        """The time that is left, once a tenth is done: before that it is no more than a guess."""

        def render(self, task: Task) -> Text:
            return super().render(task) if task.percentage >= _TELLS_TIME else Text()

    columns = [TextColumn("{task.description}"), BarColumn(), Remaining()]
    console = Console(stderr=True)
    last = time.monotonic()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task(title, total=None)

        def show(now: output.Progress) -> None:
            nonlocal last
            text = one_line(f"{title}: {now.text}")
            bar.update(task, completed=now.done, total=now.total, description=escape(text))
            if bar.disable and time.monotonic() - last > _LOG_EVERY_S:
                last = time.monotonic()
                say_line(f"{text}, {now.done:.0f} of {now.total:.0f}")

        yield show


class _Output(Console):
    """Standard output, which falls silent when its reader leaves, so that files are written yet."""

    def on_broken_pipe(self) -> None:
        """Print nothing more."""
        self.quiet = True


def report_console() -> Console:
    """Return standard output for tables.

    It is as wide as a terminal or the variable COLUMNS says, else without end.
    """
    console = _Output()
    if console.is_terminal or os.environ.get("COLUMNS", "").isdigit():
        return console
    return _Output(width=_ENDLESS)


def report_result(report: Report, written: Iterable[Path] = ()) -> None:
    """Print a report's tables and notes, and the paths of written files, on standard output."""
    print_tables(report_console(), report.tables(), report.notes(), report.verdict())
    _report_written(written)


def _report_written(written: Iterable[Path]) -> None:
    if files := ", ".join(map(make_visible, written)):
        report_console().print(Text(f"written: {files}"), soft_wrap=True)


def warn_user(text: str) -> None:
    """Print one line on standard error."""
    say_line(f"warning: {text}")
