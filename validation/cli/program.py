"""A program is a function with options that gives a report: declared once, called from Python and from the command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Generic, ParamSpec, TypeVar

import tyro

from validation import progress
from validation.cli.options import NoRerun, Seed, UserError, View, ViewWeb, Workers, option, require_rerun
from validation.cli.reporting import report_result, shown, warn
from validation.cli.running import mistakes_are_users, output_folder, require_writable, run
from validation.report.report import INTERRUPTED, Report
from validation.store import make_folder

P = ParamSpec("P")
Options = TypeVar("Options", bound="Common")
R = TypeVar("R", bound=Report)


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options that every program has."""

    seed: Seed = 0
    workers: Workers = None
    out: Annotated[Path | None, option(metavar="DIR", default="runs/PROGRAM/...", help="Folder for the files.")] = None
    progress: Annotated[progress.Report, tyro.conf.Suppress, tyro.conf.Fixed] = progress.silent
    """Called as the work goes on."""

    def folder(self) -> Path:
        """Return the folder that files are written to where `out` names none."""
        return Path("runs") / type(self).__name__.lower()


@dataclass(frozen=True, kw_only=True)
class Filmed(Common):
    """Options of a program whose robots can be seen in motion."""

    view: View = False
    view_web: ViewWeb = False
    no_rerun: NoRerun = False
    video: Annotated[Path | None, option(metavar="FILE", default="none")] = None
    """Video for slides to write (.mp4, .gif): MuJoCo's robot, the others as ghosts; drawn without a window."""

    def check(self) -> None:
        """Refuse to show a recording that is not written, and to write one without rerun, or a video that cannot be.

        Raises:
            UserError: one of these is asked for.
        """
        if (self.view or self.view_web) and self.no_rerun:
            raise UserError("--view shows the rerun recording; leave out --no-rerun")
        if not self.no_rerun:
            require_rerun("the recording", "install it, or add --no-rerun")
        if self.video is not None:
            require_rerun("a video")
            from validation.report.video import check_video

            check_video(self.video)
            make_folder(self.video.parent)


class Program(Generic[P, R]):
    """A program: called with its options it returns its report; `main` runs it from the command line."""

    def __init__(self, options: Any, function: Callable[[Any], R]) -> None:
        """Keep the dataclass of the options and the function that takes it."""
        self.options = options
        self.function = function
        self.__name__, self.__module__ = function.__name__, function.__module__
        self.__signature__ = inspect.signature(options)
        documents = [f"    {f.name}: {_field_text(self.options, f.name)}" for f in fields(self.options)]
        self.__doc__ = "\n".join([inspect.getdoc(function) or "", "", "Options:", *documents])

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Return the report of a run with these options."""
        return self.function(self.options(*args, **kwargs))

    def command(self) -> Callable[[Any], None]:
        """Return the function behind the command line: it shows progress, prints, saves and says what went wrong."""

        def main(options: Any) -> None:
            with mistakes_are_users():
                if isinstance(options, Filmed):
                    options.check()
                folder = options.out or options.folder()
                require_writable(folder)
                with shown(self.__name__) as show:
                    report = self.function(replace(options, progress=show, out=folder))
            finish(report, options, output_folder(folder))

        main.__doc__ = (inspect.getdoc(self.function) or "").partition("\n\nRaises:")[0]
        main.__annotations__ = {"options": self.options}
        return main

    def main(self) -> None:
        """Run the program with the command line of this process, and leave with the exit status that says how it went."""
        run(self.command(), f"python -m validation.{self.__name__}")


def program(options: Callable[P, Options]) -> Callable[[Callable[[Options], R]], Program[P, R]]:
    """Return the decorator that makes a function of a dataclass of options a program with these options as arguments."""
    return lambda function: Program(options, function)


def _field_text(options: Any, name: str) -> str:
    """Return the help text of an option: the docstring below its field."""
    from tyro._docstrings import get_field_docstring

    return " ".join((get_field_docstring(options, name, ()) or "").split())


def finish(report: Report, options: Common, folder: Path, *before: Path) -> None:
    """Save and print a report, make its video, show its recording, and raise what it says went wrong.

    Args:
        report: what was found.
        options: options of the program.
        folder: folder for the files.
        before: files that were written before.
    """
    film = options if isinstance(options, Filmed) else None
    written = [*before, *report.save(folder, recording=film is None or not film.no_rerun)]
    for sentence in report.alarms:
        warn(sentence)
    if film is not None and film.video is not None:
        with shown("drawing") as show:
            report.write_video(film.video, show)
        written.append(film.video)
    report_result(report, written)
    if film is not None and (film.view or film.view_web):
        from validation.report.viewer import open_viewer, serve_viewer

        (open_viewer if film.view else serve_viewer)(folder / f"{report.program}.rrd")
    if report.failure is not None:
        raise report.failure
    if report.status == INTERRUPTED:
        raise KeyboardInterrupt
