"""The command line `python -m validation.study STUDY`: one command for each study of `validation.study.catalogue`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, fields, is_dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro
from matplotlib.figure import Figure

from validation import cli, store
from validation.plants.profile import PLANTS, load
from validation.show.tables import Grid, rich_table
from validation.study.catalogue import STUDIES, Study

_SPECIAL: Mapping[str, Any] = {
    "seed": cli.Seed,
    "disturbance": Annotated[bool, cli.option(default="on")],
    "only": Annotated[cli.Names, cli.option(default="all groups")],
    "recording": Annotated[str | None, cli.option(metavar="PATH", default="none")],
    "start": Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")],
    "until": Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")],
}
"""Options, by the name of their field, that the command line does not read by their type alone."""


def _readable(name: str, kind: Any) -> Any:
    """Return the type of an option as the command line reads it: lists by comma, objects that have a name by name."""
    if name in _SPECIAL:
        return _SPECIAL[name]
    if is_dataclass(kind):
        return Annotated[kind, tyro.conf.Suppress, tyro.conf.Fixed]
    if get_origin(kind) is tuple:
        return Annotated[cli.Names if get_args(kind)[0] is str else cli.Numbers, cli.option()]
    if str in get_args(kind):
        return Annotated[str, cli.option(metavar="NAME|PATH")]
    return Annotated[kind, cli.option()]


def _command(study: Study) -> Callable[[Any], None]:
    """Return the function behind a study's command, which takes the study's options and those that every study has."""
    folder = Path("runs/study") / study.name
    hints = get_type_hints(study.options)
    names = [f.name for f in fields(study.options)]
    read = [(f.name, _readable(f.name, hints[f.name]), field(default=f.default)) for f in fields(study.options)]
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
            asked = study.options(**{name: getattr(options, name) for name in names})
            result = study.run(asked, workers=options.workers, progress=progress)
        cli.report_result(result, result.save(cli.output_folder(options.out)))

    main.__doc__ = study.question
    main.__annotations__ = {"options": options_type}
    return main


def _tables(
    *,
    profile: str = "thesis-lab",
    seeds: int = 10,
    workers: int | None = None,
    out: Path = Path("runs/study/tables"),
) -> None:
    """Make the thesis' tables of tracked references (Tab. 4.5-4.36) with the improved model and the MuJoCo Husky.

    Args:
        profile: Name of a shipped profile or path of a TOML file.
        seeds: Draws of noise and disturbance for each row.
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.tables import run as study

    with cli.mistakes_are_users():
        _check(seeds, workers)
        chosen = load(profile)
        if seeds < 1:
            raise cli.UserError(f"--seeds {seeds} must be positive")
    folder = cli.output_folder(out)
    with cli.progress() as bar:
        task = bar.add_task("tables", total=len(study.TABLES))
        result = study.study_tables(
            chosen, seeds, workers, lambda number: bar.update(task, advance=1, description=f"Tab. {number}")
        )
    written = _write(folder, study.as_document(result), study.draw_tables(result), study.markdown(result))
    _report([(study.grid(result, kind), caption, "") for kind, caption in study.CAPTIONS.items()], [], written)


def _gains(
    *,
    profile: str = "thesis-lab",
    plants: str = "improved,mujoco",
    seeds: int = 3,
    seed: int = 11,
    workers: int | None = None,
    out: Path = Path("runs/study/gains"),
) -> None:
    """Drive every shipped set of gains along every named reference at both of the thesis' speeds.

    Args:
        profile: Name of a shipped profile or path of a TOML file.
        plants: Which robots, comma-separated.
        seeds: Draws of noise and disturbance.
        seed: The first of them; no shipped set was tuned on those from 11 on.
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.gains import run as study

    with cli.mistakes_are_users():
        _check(seed, workers)
        if seeds < 1:
            raise cli.UserError(f"--seeds {seeds} must be positive")
        wanted = cli.parse_names(plants, PLANTS, "plant")
        chosen = load(profile)
    folder = cli.output_folder(out)
    with cli.progress() as bar:
        task = bar.add_task("gains", total=len(wanted) * len(study.REFERENCES) * len(study.SPEEDS))

        def tell(what: str) -> None:
            bar.update(task, advance=1, description=what)

        result = study.study_gains(chosen, wanted, range(seed, seed + seeds), workers, tell)
    written = _write(folder, study.as_document(result), study.draw_gains(result), study.markdown(result))
    _report([(table, title, "") for table, title in study.tables(result)], [], written)


def _old(function: Callable[..., None]) -> Callable[[Any], None]:
    """Return a command made from a function with one parameter for each option."""
    hints = get_type_hints(function)
    read = [(p.name, hints[p.name], field(default=p.default)) for p in inspect.signature(function).parameters.values()]
    options_type = make_dataclass(function.__name__, read)

    def main(options: Any) -> None:
        function(**vars(options))

    main.__doc__ = (function.__doc__ or "").partition("\n")[0]
    main.__annotations__ = {"options": options_type}
    return main


_OLD: Mapping[str, Callable[..., None]] = {"tables": _tables, "gains": _gains}
"""Studies that are not yet declared in `STUDIES`."""


def _check(seed: int, workers: int | None) -> None:
    if seed < 0 or (workers is not None and workers < 1):
        raise cli.UserError(f"--seed {seed} must not be negative and --workers {workers} must be positive")


def _split_once(text: str, what: str) -> list[str]:
    """Comma-separated names, none twice.

    Raises:
        UserError: none at all, or one twice.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names or len(set(names)) < len(names):
        raise cli.UserError(f"{what} '{text}' must name at least one, and none twice")
    return names


def _write(folder: Path, document: Mapping[str, Any], figure: Figure, report: Sequence[str]) -> list[Path]:
    """Write study.png, study.md and, last, study.json; return what was written."""
    from validation.show.drawing import save_figure

    picture, text, numbers = (folder / f"study.{ending}" for ending in ("png", "md", "json"))
    save_figure(figure, picture)
    store.write_atomic(text, lambda temporary: temporary.write_text("\n".join(report), encoding="utf-8"))
    store.write_json(numbers, document)
    return [picture, text, numbers]


def _report(tables: Sequence[tuple[Grid, str, str]], remarks: Sequence[str], written: Sequence[Path]) -> None:
    for remark in remarks:
        cli.warn(remark)
    cli.report((rich_table(grid, title, caption) for grid, title, caption in tables), (), written)


def program() -> Mapping[str, Callable[[Any], None]]:
    """Return the function behind each command."""
    return {**{study.name: _command(study) for study in STUDIES}, **{name: _old(f) for name, f in _OLD.items()}}


if __name__ == "__main__":
    cli.run(program(), "python -m validation.study")
