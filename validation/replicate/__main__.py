"""The command line `python -m validation.replicate`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from validation import cli
from validation.replicate.evidence import QUICK_SETTINGS, ReplicationSettings, chosen_sections
from validation.replicate.real import require_usable
from validation.replicate.result import require_markdown
from validation.replicate.run import ALL_SECTIONS, ReplicationInterrupted, replicate


@dataclass(frozen=True)
class _Log:
    """Options of the last chapter, which compares the plants with a log of a real Husky."""

    recording: Annotated[Path | None, cli.option(metavar="PATH", default="none; the chapter then says so")] = None
    """Log of a real Husky: a bag, or a CSV file with the columns t, x, y, yaw and enc_left, enc_right or cmd_v, cmd_w."""
    split: Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end of what husky-tile was fitted to")] = None
    """Score what was recorded after this time by itself [s]."""


@dataclass(frozen=True)
class _Output:
    """Options for what is kept and written."""

    out: Annotated[Path, cli.out_option("runs/replicate")] = Path("runs/replicate")
    docs: Annotated[Path | None, cli.option(metavar="FILE.md", default="none")] = None
    """Write the report there too, such as docs/results.md, with its pictures in img/ beside it."""
    fresh: cli.Flag = False
    """Run everything anew, searches too, whatever is kept."""


@dataclass(frozen=True)
class ReplicateCommand:
    """The options of `python -m validation.replicate`."""

    quick: cli.Flag = False
    """Use reduced budgets, which take under three minutes."""
    only: Annotated[cli.Names, cli.option(default="all")] = ()
    """Sections or tables to run, such as 3.9,4.5 or times. A wrong name lists all sections."""
    log: _Log = _Log()
    seed: cli.Seed = 1
    workers: cli.Workers = None
    output: _Output = _Output()


def main(options: ReplicateCommand) -> None:
    """Repeat everything that the thesis reports, with a verdict for each row.

    Writes replicate.json, replicate.md and replicate.html into the folder --out.

    The next run reuses finished sections unless settings, inputs or code change.

    Ctrl-C keeps finished sections, and unfinished searches as far as they are.
    """
    log, output = options.log, options.output
    with cli.mistakes_are_users():
        chosen_sections(ALL_SECTIONS, options.only)
        if log.recording is not None:
            require_usable(log.recording)
        if output.docs is not None:
            require_markdown(output.docs)
        settings = replace(
            QUICK_SETTINGS if options.quick else ReplicationSettings(),
            seed=options.seed,
            recording="" if log.recording is None else str(log.recording),
            split=log.split,
        )
    folder = cli.output_folder(output.out)
    if output.docs is not None:
        cli.output_folder(output.docs.parent)
    try:
        with cli.shown("replicating") as progress:
            result = replicate(
                settings, options.only, folder, fresh=output.fresh, workers=options.workers, progress=progress
            )
    except ReplicationInterrupted as stop:
        again = "the same command without --fresh" if output.fresh else "the same command"
        cli.warn(f"{stop.done} of {stop.total} sections are kept in {folder}; {again} goes on from there")
        raise
    written = result.save(folder)
    if output.docs is not None:
        written.append(result.publish(output.docs))
    cli.report_result(result, written)


PROGRAM = main

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.replicate")
