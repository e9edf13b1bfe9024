"""The command line `python -m validation.robots list|check|new|import|export`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from validation import cli
from validation.robots.result import DraftedRobot
from validation.words import file_name, visible


@dataclass(frozen=True)
class ListOptions:
    """The options of `list`; there are none."""


@dataclass(frozen=True)
class CheckOptions:
    """The options of `check`."""

    robot: Annotated[str, tyro.conf.Positional, cli.option(metavar="ROBOT")]
    """Name of a robot that comes with the package, or path of a robot's file."""
    out: Annotated[Path | None, cli.out_option("runs/robots/NAME")] = None


@dataclass(frozen=True)
class NewOptions:
    """The options of `new`. Lengths and masses are in m and kg."""

    name: Annotated[str, tyro.conf.Positional, cli.option(metavar="NAME")]
    """Name of the robot: letters, digits, - and _."""
    wheelbase: Annotated[float, cli.option(metavar="M")]
    """Distance of the axles."""
    track: Annotated[float, cli.option(metavar="M")]
    """Distance of the middles of the left and right tyres."""
    wheel_radius: Annotated[float, cli.option(metavar="M")]
    """Rolling radius of the wheels: what the robot drives in one turn of them, over 2 pi."""
    wheel_width: Annotated[float, cli.option(metavar="M")]
    """Width of the tyres."""
    mass: Annotated[float, cli.option(metavar="KG")]
    """Mass of the whole robot, with battery."""
    wheel_mass: Annotated[cli.Number, cli.option(metavar="KG", default="3.6 % of the whole")] = None
    """Mass of one wheel."""
    axle_height: Annotated[cli.Number, cli.option(metavar="M", default="0")] = None
    """Height of the axles above the base frame's origin."""
    friction: Annotated[cli.Number, cli.option(metavar="MU", default="0.3")] = None
    """Sliding friction of its tyres on the ground."""
    torque_limit: Annotated[cli.Number, cli.option(metavar="NM", default="enough on ground of friction 1")] = None
    """Greatest torque of one wheel [N m]."""
    v_max: Annotated[cli.Number, cli.option(metavar="M/S", default="no limit")] = None
    """Greatest speed that its driver accepts."""
    w_max: Annotated[cli.Number, cli.option(metavar="RAD/S", default="no limit")] = None
    """Greatest yaw rate that its driver accepts."""
    command_half_track: Annotated[cli.Number, cli.option(metavar="M", default="half of the track")] = None
    """Half of the track that its driver makes wheel rates of yaw rates with: wheel separation times multiplier, halved."""
    link: Annotated[Literal["belt", "none"], cli.option()] = "belt"
    """Link between the wheels of a side: belt, they turn together; none, each wheel has a motor."""
    title: Annotated[str, cli.option(default="none")] = ""
    """Name for people, with the maker's."""
    out: Annotated[Path | None, cli.option(metavar="FILE", default="NAME.toml")] = None
    """File to write; there must be none of that name."""


@dataclass(frozen=True)
class ImportOptions:
    """The options of `import`."""

    file: Annotated[Path, tyro.conf.Positional, cli.option(metavar="FILE.urdf")]
    """URDF of a robot with four wheels; a xacro file must be expanded before."""
    name: Annotated[str | None, cli.option(metavar="NAME", default="the URDF's")] = None
    """Name of the robot: letters, digits, - and _."""
    wheel_radius: Annotated[cli.Number, cli.option(metavar="M", default="read or guessed")] = None
    """Rolling radius of the wheels."""
    wheel_width: Annotated[cli.Number, cli.option(metavar="M", default="read or guessed")] = None
    """Width of the tyres."""
    out: Annotated[Path | None, cli.option(metavar="FILE", default="NAME.toml")] = None
    """File to write; there must be none of that name."""


@dataclass(frozen=True)
class ExportOptions:
    """The options of `export`."""

    robot: Annotated[str, tyro.conf.Positional, cli.option(metavar="ROBOT")]
    """Name of a robot that comes with the package, or path of a robot's file."""
    to: Annotated[Literal["urdf", "sdf"], cli.option()] = "urdf"
    """Format: urdf for ROS, sdf for Gazebo."""
    out: Annotated[Path | None, cli.option(metavar="FILE", default="NAME.urdf or NAME.sdf")] = None
    """File to write; there must be none of that name."""


def _list(options: ListOptions) -> None:
    """List the robots that come with the package, and the profiles of each."""
    from validation.robots.run import list_robots

    cli.report_result(list_robots())


def _check(options: CheckOptions) -> None:
    """Check a robot: what is wrong with its file, and what would be right.

    Builds it in MuJoCo, turns it on the spot and weighs its wheels.

    Prints every number with its source, and writes robot.json and robot.png.
    """
    from validation.robots.run import check_robot

    with cli.mistakes_are_users():
        found = check_robot(options.robot)
    folder = cli.output_folder(options.out or Path("runs") / "robots" / file_name(found.robot.name))
    cli.report_result(found, found.save(folder))


def _new(options: NewOptions) -> None:
    """Write the file of a new robot from what a tape measure and a scale say.

    The file says which of its numbers are measured and which are estimates, and this program says what to measure next.
    """
    from validation.robots.drafting import TapeMeasure, draft_from_tape

    with cli.mistakes_are_users():
        known = TapeMeasure(
            options.wheelbase, options.track, options.wheel_radius, options.wheel_width, options.mass, options.wheel_mass,
            options.axle_height, options.friction, options.torque_limit, options.v_max, options.w_max,
            options.command_half_track, options.link, options.title,
        )  # fmt: skip
        drafted = draft_from_tape(options.name, known)
    _write(drafted, options.out)


def _import(options: ImportOptions) -> None:
    """Write a robot's file from a URDF.

    Finds the wheels by their joints, and puts the masses of everything else together. Meshes are not needed.

    Says what the URDF does not, and had to be guessed.
    """
    from validation.robots.importing import import_robot

    with cli.mistakes_are_users():
        drafted = import_robot(options.file, options.name, options.wheel_radius, options.wheel_width)
    _write(drafted, options.out)


def _export(options: ExportOptions) -> None:
    """Write a robot as a URDF or as an SDF model: shapes, masses, inertia and joints; of an SDF friction and torque too.

    How a robot's driver and motors act neither format can say.
    """
    from validation import store
    from validation.robots.run import export_robot
    from validation.simulator.description import load_robot

    with cli.mistakes_are_users():
        robot = load_robot(options.robot)
        target = options.out or Path(f"{file_name(robot.name)}.{options.to}")
        if target.exists():
            raise cli.UserError(f"--out {target}: there is such a file already; name another")
        with cli.writes("--out", target):
            store.write_text(target, export_robot(robot, options.to))
    cli.report_console().print(f"written: {visible(target)}", markup=False, highlight=False, soft_wrap=True)


def _write(drafted: DraftedRobot, out: Path | None) -> None:
    """Write a new robot's file, and say how to go on."""
    target = out or Path(f"{drafted.robot.name}.toml")
    with cli.mistakes_are_users():
        with cli.writes("--out", target):
            drafted.save(target)
    cli.report_result(drafted, [target])
    cli.report_console().print(
        f"next: python -m validation.robots check {visible(target)}", markup=False, highlight=False, soft_wrap=True
    )


PROGRAM: Mapping[str, Callable[[Any], None]] = {
    "list": _list,
    "check": _check,
    "new": _new,
    "import": _import,
    "export": _export,
}

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.robots")
