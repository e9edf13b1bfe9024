"""The command line `python -m validation.study STUDY`: one command for each study of `validation.study.catalogue`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field, fields, is_dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro

from validation import cli
from validation.study.catalogue import STUDIES, Study
from validation.study.result import INTERRUPTED

_SPECIAL: Mapping[str, Any] = {
    "seed": cli.Seed,
    "recording": Annotated[str | None, cli.option(metavar="PATH", default="none")],
    "ground": Annotated[str | None, cli.option(metavar="PATH", default="none")],
    "held_out": Annotated[cli.Names, cli.option(metavar="PATH,...", default="none")],
    "robot": cli.RobotName,
    "profile": Annotated[str | None, cli.profile_option("thesis-lab")],
    "drivetrain.robot": Annotated[str | None, cli.option(metavar="ROBOT", default="the battery's voltage tells")],
    "drivetrain.profile": Annotated[str | None, cli.profile_option("husky-tile")],
    "mass": Annotated[cli.Number, cli.option(metavar="KG", default="the profile's")],
    "torque_constant": Annotated[cli.Number, cli.option(metavar="K", default="unknown")],
    "start": Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")],
    "until": Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")],
}
"""Options, by the name of their field or of study and field, that the command line does not read by their type alone."""


def _readable(study: str, name: str, kind: Any) -> Any:
    """Return the type of an option as the command line reads it: lists by comma, objects that have a name by name."""
    special = _SPECIAL.get(f"{study}.{name}", _SPECIAL.get(name))
    if special is not None:
        return special
    if is_dataclass(kind):
        return Annotated[kind, tyro.conf.Suppress, tyro.conf.Fixed]
    if get_origin(kind) is tuple:
        return Annotated[cli.Names if get_args(kind)[0] is str else cli.Numbers, cli.option()]
    if str in get_args(kind):
        return Annotated[str, cli.option(metavar="NAME|PATH")]
    return Annotated[kind, cli.option()]


def _command(study: Study) -> Callable[[Any], None]:
    """Return the function behind a study's command, which takes the study's options and those that every study has."""
    if isinstance(study.run, cli.Program):
        return study.run.command()
    folder = Path("runs/study") / study.name
    hints = get_type_hints(study.options)
    names = [f.name for f in fields(study.options)]
    read = [(f.name, _readable(study.name, f.name, hints[f.name]), field(default=f.default)) for f in fields(study.options)]
    own = [
        ("workers", cli.Workers, field(default=None)),
        ("out", Annotated[Path, cli.out_option(str(folder))], field(default=folder)),
    ]
    unchecked = {"__post_init__": lambda self: None}  # mistakes are said where the study's own options are made
    options_type = make_dataclass(
        study.options.__name__, [*read, *own], bases=(study.options,), namespace=unchecked, frozen=True
    )

    def main(options: Any) -> None:
        with cli.mistakes_are_users(), cli.shown(study.name) as progress:
            cli.require_writable(options.out)
            asked = study.options(**{name: getattr(options, name) for name in names})
            result = study.run(asked, workers=options.workers, progress=progress)
        cli.report_result(result, result.save(cli.output_folder(options.out)))
        if result.status == INTERRUPTED:
            raise KeyboardInterrupt

    main.__doc__ = study.question
    main.__annotations__ = {"options": options_type}
    return main


PROGRAM: Mapping[str, Callable[[Any], None]] = {study.name: _command(study) for study in STUDIES}

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.study")
