"""Robots as data: list, check, begin the file of a new one, import and export.

On the command line: `python -m validation.robots COMMAND`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import tyro

from ssmr.errors import SsmrError
from ssmr.robot.ground import FRONT, LEFT
from validation import cli, output
from validation.descriptions.balance import TURN
from validation.descriptions.examination import Examined, examine_foreign, examine_model
from validation.descriptions.findings import Finding, static_findings
from validation.descriptions.foreign_robot import is_description
from validation.descriptions.importing import RobotDraft, draft_robot, import_robot, unit_of_key
from validation.descriptions.influences import STOPPING
from validation.descriptions.loading import load_robot
from validation.engines.trial import examine_in_engine
from validation.files.reading import read_text
from validation.identify.problem import turning_doubt
from validation.output import Document, abridge_text, file_name, make_visible, one_line
from validation.plants.profile import (
    Profile,
    bare_profile,
    choose_profile,
    fitted_errors,
    load_profile,
    odometry_variances,
    shipped_profiles,
)
from validation.report.report import Report
from validation.report.table import Table, print_tables
from validation.simulator import exporting
from validation.simulator.checking import (
    SkidTurn,
    guessed_numbers,
    load_shares,
    robot_outline,
    spot_turn,
    turning_torque,
    whole_com,
)
from validation.simulator.description import (
    GRAVITY,
    SCHEMA,
    SECTIONS,
    Robot,
    shipped_robots,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ExportFormat = Literal["urdf", "sdf", "mjcf", "diff-drive", "nav2"]
"""Formats of `export`."""
_MOST_FINDINGS = 5
"""Number of findings that are printed; all are in robot.json."""
_ALWAYS = {"drive.torque_limit", "drive.v_max", "drive.w_max", "drive.command_half_track"}
"""Numbers of the drive that are shown even where the file does not say them."""


# --- list and check ---


def list_robots() -> None:
    """List the robots that come with the package, and the profiles of each."""
    profiles = [load_profile(name) for name in shipped_profiles()]
    rows = []
    for robot in map(load_robot, shipped_robots()):
        spot = spot_turn(robot)
        of_robot = ", ".join(p.name for p in profiles if p.robot.name == robot.name)
        row = {"name": robot.name, "robot": robot.title, **_sizes_of(robot)}
        rows.append({**row, "multiplier": spot and spot.multiplier, "profiles": of_robot or None})
    caption = (
        "multiplier: yaw rate that the wheels ask for over that of the body, "
        "turning on the spot, by mechanics"
    )
    _print_tables([Table("Robots that come with the package", rows, caption)])


@dataclass(frozen=True)
class CheckRobot(cli.Common):
    """Options of `check`."""

    robot: tyro.conf.Positional[str | Path | Robot]
    """Name of a robot that comes with the package, or path of a robot's file, a URDF, an SDF or an
    MJCF."""
    controller: cli.AnyPath = None
    """YAML of the controller that drives a URDF, an SDF or an MJCF; the file's plugins if not
    given."""
    engine: Literal["mujoco", "ode", "drake"] = "mujoco"
    """Engine that turns a URDF, an SDF or a robot's file: ode has Gazebo's settings and the file's
    contacts. An MJCF has its own."""
    write: cli.AnyPath = None
    """File for an MJCF with the changes that help, and no other; there must be none of that
    name."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        if not isinstance(self.robot, Robot) and is_description(self.robot):
            return Path("runs") / "robots" / file_name(Path(self.robot).stem)
        return Path("runs") / "robots" / file_name(load_robot(self.robot).name)

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        return "robot.json", "robot.png"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class RobotCheck(Report):
    """Report on whether a robot can be as its file describes it, with the numbers that show it."""

    program = "robot"
    robot: Robot
    """The robot."""
    spot: SkidTurn | None
    """How it turns on the spot by mechanics; None where it does not stand on four wheels."""
    examined: Examined
    """Result of its trials: with its own physics, in an engine, or of our MuJoCo model of it."""
    findings: Sequence[Finding]
    """Findings, faults first."""

    @property
    def faults(self) -> list[str]:
        """Sentences on faults, each with its remedy."""
        return [finding.sentence for finding in self.findings if finding.severity == "fault"]

    @property
    def ok(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    @property
    def loads(self) -> list[float]:
        """Loads of the four wheels at rest [N]: of the MuJoCo model, or by mechanics."""
        if self.examined.loads:
            return list(self.examined.loads)
        weight = self.robot.mass * GRAVITY
        return [float(share) * weight for share in load_shares(self.robot)]

    def tables(self) -> list[Table]:
        """Return all numbers with their sources."""
        tables = [_numbers_table(self.robot)]
        if rows := self.examined.balance:
            tables.append(Table("Balance", [row.as_text() for row in rows]))
        return tables

    def notes(self) -> list[str]:
        """Return the verdict, faults and questions."""
        notes = [_check_verdict(self.robot, self.findings)]
        sentences = self.examined.sentences
        if not sentences and self.remarks and self.spot is not None:
            turned = 90.0 / self.spot.multiplier
            sentences = [f"By mechanics it turns {turned:.0f}° for 90° on its wheels, which skid."]
        notes = [*sentences[:1], *notes]
        for finding in self.findings[:_MOST_FINDINGS]:
            heading = "FAULT" if finding.severity == "fault" else "question"
            notes.append(f"{heading}: {finding.sentence}")
        if len(self.findings) > _MOST_FINDINGS:
            notes.append(f"and {len(self.findings) - _MOST_FINDINGS} more, in robot.json")
        notes += [*sentences[1:], *self.remarks]
        if self.remarks and self.spot is not None and not self._is_off():
            notes.append(
                "last of all: a diff_drive_controller turns it as told with wheel_separation "
                f"{self.robot.track:.4g} and wheel_separation_multiplier "
                f"{self.spot.multiplier:.3f}, by mechanics"
            )
        return notes

    def _is_off(self) -> bool:
        """Return whether no multiplier mends it: its weight is off, or drives show another turn."""
        turns = [row for row in self.examined.balance if row.row == TURN and row.excess > 1.0]
        return bool(turns) or any(finding.kind == "weight_off" for finding in self.findings)

    def document(self) -> Document:
        """Return the contents of robot.json."""
        return {
            **_robot_document(self.robot, self.spot, self.loads),
            **self.examined.numbers,
            "balance": [row.as_dict() for row in self.examined.balance],
            "ok": self.ok,
            "findings": [finding._asdict() for finding in self.findings],
            "advice": [finding.sentence for finding in self.findings],
            "faults": len(self.faults),
            "guessed": guessed_numbers(self.robot),
        }

    def figure(self) -> Figure:
        """Draw the robot from above, with its hull, tyres, their loads, and the centre of mass."""
        from validation.report.drawing import PanelRow, draw_page

        low, high = robot_outline(self.robot)
        length, width, _ = high - low
        verdict = "no fault found" if self.ok else "something is wrong"
        title = f"{abridge_text(self.title, 60)}: {verdict}"
        height = min(10.0 * width / length + 1.4, 7.0)
        row = PanelRow(height, [partial(_draw_from_above, self)])
        return draw_page(title, [row], notes=[finding.sentence for finding in self.findings])


@cli.make_program(CheckRobot)
def check_robot(o: CheckRobot) -> RobotCheck:
    """Check a robot: what is wrong with its file, and what would be right.

    Drives it in MuJoCo, and weighs what is there against what mechanics says. An MJCF of others is
    driven with its own physics, and changes are tried before they are named.

    Prints every number with its source, and writes robot.json and robot.png. The exit status is 1
    where something is wrong.

    Raises:
        ValueError: there is no such robot, or its file cannot be read. Numbers that can be read
            and are impossible are advice.
    """
    draft = None
    if not isinstance(o.robot, Robot) and is_description(o.robot):
        draft = import_robot(o.robot, controller=o.controller)
    elif o.controller is not None:
        raise ValueError("--controller goes with a URDF, an SDF or an MJCF; ROBOT is none")
    foreign = None if draft is None else draft.foreign
    robot = load_robot(o.robot) if draft is None else draft.robot
    findings = static_findings(robot, foreign)
    if foreign is not None and foreign.kind == "mjcf":
        if o.engine != "mujoco":
            raise ValueError(f"--engine {o.engine}: an MJCF is driven by the engine that it is of")
        examined = examine_foreign(robot, foreign, findings)
        if o.write is not None and examined.mended is None:
            raise ValueError(f"--write {o.write}: no change helps, so there is nothing to write")
        if o.write is not None and examined.mended is not None:
            _save_text(examined.mended, Path(o.write), "--write")
    elif o.write is not None:
        raise ValueError("--write goes with an MJCF, whose physics are in its file; ROBOT is none")
    elif o.engine != "mujoco":
        examined = examine_in_engine(robot, foreign, o.engine)
    else:
        examined = examine_model(robot, findings)
    # trials of changes know better than numbers alone
    causes = {finding.cause for finding in examined.findings}
    tried = {f.kind for f in examined.findings if f.after is not None and f.severity == "fault"}
    refuted = STOPPING if examined.closes else ()
    findings = [f for f in findings if f.cause not in causes and f.kind not in tried]
    findings = [f for f in findings if f.severity != "fault" or f.kind not in refuted]
    findings += examined.findings
    findings.sort(key=lambda finding: finding.severity)
    report = RobotCheck(
        title=one_line(robot.title or robot.name),
        robot=robot,
        spot=spot_turn(robot),
        examined=examined,
        findings=findings,
        remarks=[] if draft is None else draft.remarks,
    )
    return (
        report if report.ok else replace(report, failure=SsmrError(_check_verdict(robot, findings)))
    )


def _check_verdict(robot: Robot, findings: Sequence[Finding]) -> str:
    """Finding of a check in a sentence; a robot with guessed numbers may still be wrong."""
    if faults := sum(finding.severity == "fault" for finding in findings):
        return f"{robot.name}: {faults} fault{'s' if faults > 1 else ''} found"
    if guesses := ", ".join(guessed_numbers(robot)):
        return f"{robot.name}: no fault found, but nobody has measured or published {guesses}"
    if findings:
        return f"{robot.name}: no fault found"
    return f"{robot.name}: nothing is wrong with it"


def _sizes_of(robot: Robot) -> dict[str, float]:
    """Return the numbers by which robots are told apart, as tables and files have them."""
    return {
        "mass_kg": robot.mass,
        "wheelbase_m": robot.wheelbase,
        "track_m": robot.track,
        "wheel_radius_m": robot.wheel_radius,
    }


def _robot_document(robot: Robot, spot: SkidTurn | None, loads: Sequence[float]) -> Document:
    """Contents of robot.json; None stands for a number that no model could show."""
    mu = robot.friction
    drive = robot.drive
    torque = None
    if spot is not None:
        torque = mu * turning_torque(robot, spot) + drive.gear_loss
    numbers = {}
    for key, value in _every_number(robot).items():
        numbers[key] = {"value": value, "unit": unit_of_key(key)}
    return {
        "schema": SCHEMA,
        "name": robot.name,
        "title": robot.title,
        **_sizes_of(robot),
        "turning_multiplier": None,
        "closed_form": None if spot is None else spot.multiplier,
        "yaw_ripple": None,
        "static_loads_N": loads,
        "apparent_mass_kg": None,
        "friction": mu,
        "side_torque_needed_N_m": torque,
        "side_torque_N_m": 2.0 * drive.torque_limit,
        "numbers": numbers,
    }


def _every_number(robot: Robot) -> Document:
    """Numbers of a robot by `section.key`, without names and those of planar models only."""
    shown = {*robot.given, *_ALWAYS}
    values = {}
    for section, names in SECTIONS.items():
        for name in names:
            key = f"{section}.{name}"
            is_of_few = section in ("drive", "vehicle") or name == "joints"
            if key in shown or not is_of_few:
                values[key] = robot.number(key)
    return values


def _numbers_table(robot: Robot) -> Table:
    """Table of all numbers of a robot; its caption has the sources, which many share."""
    rows = []
    sources: dict[str, int] = {}
    for key, value in _every_number(robot).items():
        grade, source = robot.source(key)
        # a source is numbered where it is named first
        number = sources.setdefault(source, len(sources) + 1)
        names: Sequence[str] = "xyz"
        if key == "mass.wheel_inertia":
            names = ("across", "spin")
        if not isinstance(value, tuple):
            names = ("",)
            value = (value,)
        for name, part in zip(names, value, strict=True):
            rows.append(
                {
                    "section": key.partition(".")[0],
                    "number": f"{key} {name}".strip(),
                    "unit": unit_of_key(key) or None,
                    "value": part,
                    "grade": f"{grade} [{number}]",
                }
            )
    caption = "\n".join(f"[{n}] {one_line(source)}" for source, n in sources.items())
    title = f"{one_line(robot.title or robot.name)}: its numbers"
    return Table(title, rows, caption, group="section", hidden=frozenset({"section"}))


# --- the picture ---


def _draw_from_above(check: RobotCheck, ax: Axes) -> None:
    from matplotlib.patches import Rectangle

    from validation.report.drawing import equal_scales

    robot = check.robot
    tyre = (2.0 * robot.wheel_radius, robot.wheel_width)
    boxes = [(robot.body_centre[:2], robot.body_size[:2], "#f6e3a1")]
    for front, left, load in zip(FRONT, LEFT, check.loads, strict=True):
        axle = (0.5 * front * robot.wheelbase, 0.5 * left * robot.track)
        boxes.append((axle, tyre, "0.8"))
        ax.text(*axle, f"{load:.0f} N", ha="center", va="center", zorder=6.0)
    for (x, y), (long, wide), ink in boxes:
        corner = (x - 0.5 * long, y - 0.5 * wide)
        ax.add_patch(Rectangle(corner, long, wide, facecolor=ink, edgecolor="0.1", zorder=1.6))
    x, y, _ = whole_com(robot)
    ax.plot(x, y, "P", markersize=9.0, color="black", zorder=5.0)
    below = y - 0.05 * robot.body_size[1]
    ax.text(x, below, "centre of mass", ha="center", va="top", zorder=6.0)
    equal_scales(ax, 0.0)
    ax.set(
        xlabel="x, forward [m]",
        ylabel="y, to the left [m]",
        title="From above, with the loads at rest",
    )


# --- new, import, export ---


def _new(
    name: tyro.conf.Positional[str],
    *,
    wheelbase: float,
    track: float,
    wheel_radius: float,
    wheel_width: float,
    mass: float,
    out: Path | None = None,
) -> None:
    """Write the file of a new robot from what a tape measure and a scale say.

    The file says which of its numbers are measured and which are estimates, and this program says
    what to measure next. Any other number can be written into the file afterwards.

    Args:
        name: Name of the robot: letters, digits, - and _.
        wheelbase: Distance of the axles [m].
        track: Distance of the middles of the left and right tyres [m].
        wheel_radius: Rolling radius of the wheels [m]: what the robot drives in one turn of them,
            over 2 pi.
        wheel_width: Width of the tyres [m].
        mass: Mass of the whole robot, with battery [kg].
        out: File to write; there must be none of that name. NAME.toml if not given.
    """
    numbers = {
        "geometry.wheelbase": wheelbase,
        "geometry.track": track,
        "geometry.wheel_radius": wheel_radius,
        "geometry.wheel_width": wheel_width,
        "mass.total": mass,
    }
    _write_draft(draft_robot(name, numbers), out)


def _import(
    file: tyro.conf.Positional[Path],
    *,
    name: str | None = None,
    wheel_radius: float | None = None,
    wheel_width: float | None = None,
    controller: Path | None = None,
    out: Path | None = None,
) -> None:
    """Write a robot's file from a URDF, an SDF or an MJCF.

    Finds the wheels by their joints, and puts the masses of everything else together. Meshes are
    not needed.

    Says what is wrong with the file, what it does not say, and what had to be guessed.

    Args:
        file: URDF, SDF or MJCF of a robot with four wheels; a xacro file is expanded where the
            package `xacro` is installed.
        name: Name of the robot: letters, digits, - and _; the file's if not given.
        wheel_radius: Rolling radius of the wheels [m]; read or guessed if not given.
        wheel_width: Width of the tyres [m]; read or guessed if not given.
        controller: YAML of the robot's controller, whose separation and radius its driver has; the
            file's plugins if not given.
        out: File to write; there must be none of that name. NAME.toml if not given.
    """
    draft = import_robot(file, name, wheel_radius, wheel_width, controller)
    findings = static_findings(draft.robot, draft.foreign)
    remarks = [f"{finding.severity}: {finding.sentence}" for finding in findings]
    _write_draft(draft._replace(remarks=[*remarks, *draft.remarks]), out)


def _write_draft(draft: RobotDraft, out: Path | None) -> None:
    target = out or Path(f"{draft.robot.name}.toml")
    _save_text(draft.text, target)
    check = f"next: python -m validation.robots check {make_visible(target)}"
    _print_tables(
        [_numbers_table(draft.robot)], [*draft.remarks, f"written: {make_visible(target)}", check]
    )


def _holds_text(target: Path, text: str) -> bool:
    """Return whether a file has this text, as where the same command was interrupted behind it."""
    try:
        return read_text(target, len(text.encode("utf-8", "backslashreplace"))) == text
    except ValueError:
        return False


def _save_text(text: str, target: Path, option: str = "--out") -> None:
    if target.exists() or target.is_symlink():
        if _holds_text(target, text):
            return
        raise ValueError(
            f"{option} {target}: there is such a file already, and it is not overwritten; "
            "name another"
        )
    output.write_text(output.make_folder(target.parent) / target.name, text)


def _print_tables(tables: Sequence[Table], notes: Sequence[str] = ()) -> None:
    print_tables(cli.report_console(), tables, notes)


def export_robot(
    robot: str | Path | Robot,
    to: ExportFormat = "urdf",
    profile: str | Path | Profile | None = None,
    errors: Mapping[str, float] = MappingProxyType({}),
    timestep: float | None = None,
) -> str:
    """Return a robot as text in the format of another program.

    That is a URDF, an SDF model for Gazebo, an MJCF with motors and sensors, or the numbers of
    ros2_control's diff_drive_controller or of nav2.

    Args:
        robot: name of a shipped robot, path of a robot's file, or the robot itself.
        to: the format.
        profile: its profile, not for URDF and SDF; the numbers of the robot's file if not given.
        errors: standard errors of the numbers for ros2_control, by the names of that file.
        timestep: physics step of an MJCF [s]; the profile's if not given.

    Raises:
        ValueError: robot or profile cannot be read; the profile is another robot's or has no place
            in the format; the step has none or cannot be; or the robot cannot turn.
    """
    chosen = load_robot(robot)
    if timestep is not None and to != "mjcf":
        raise ValueError(f"timestep: {to} has no place for it, only mjcf has")
    if profile is not None and to in ("urdf", "sdf"):
        raise ValueError(
            f"profile: a {to.upper()} has no place for its numbers; mjcf, diff-drive and nav2 have"
        )
    numbers = bare_profile(chosen) if profile is None else choose_profile(profile, chosen, "")
    if to == "mjcf":
        section = numbers.section("mujoco")
        step = section.parameters.timestep if timestep is None else timestep
        return exporting.mjcf_text(replace(section.parameters, timestep=step), section.drive)
    kinematic = numbers.section("kinematic")
    fitted, source = fitted_errors(numbers, "kinematic")
    if to == "nav2":
        return exporting.nav2_yaml(chosen, kinematic.drive, fitted, source)
    if to == "diff-drive":
        p = kinematic.parameters
        multiplier = (p.y_l - p.y_r) / chosen.track
        if profile is None:
            spot = spot_turn(chosen)
            if spot is None:
                raise ValueError(
                    f"robot {chosen.name} does not stand on its four wheels; `check` says why"
                )
            multiplier = spot.multiplier
            errors = {"wheel_separation_multiplier": turning_doubt(chosen)}
        share = kinematic.vehicle.wheel_radius / chosen.wheel_radius
        radii = (share * p.alpha_l, share * p.alpha_r)
        variances = odometry_variances(numbers)
        return exporting.diff_drive_yaml(
            chosen, kinematic.drive, multiplier, radii, errors, fitted=fitted, variances=variances
        )
    if to == "sdf":
        return exporting.sdf_text(chosen)
    return exporting.urdf_text(chosen)


def _export(
    robot: tyro.conf.Positional[str],
    *,
    to: ExportFormat = "urdf",
    profile: str | None = None,
    timestep: float | None = None,
    out: Path | None = None,
) -> None:
    """Write a robot as a URDF, an SDF or an MJCF model, or its numbers for ros2_control or nav2.

    An SDF has friction and torque, too. An MJCF drives in plain MuJoCo like the robot here, on
    level ground.

    Args:
        robot: Name of a robot that comes with the package, or path of a robot's file.
        to: urdf for ROS, sdf for Gazebo, mjcf for MuJoCo, diff-drive for ros2_control's
            diff_drive_controller, nav2 for its MPPI and its velocity smoother.
        profile: Profile of this robot, whose numbers all but urdf and sdf then have: name of a
            shipped one, or path (.toml).
        timestep: Physics step for which an mjcf is written [s], the profile's if not given; the
            file says up to which it will do.
        out: File to write; there must be none of that name. NAME.FORMAT if not given.
    """
    ending = {"diff-drive": "yaml", "nav2": "nav2.yaml"}.get(to, to)
    target = out or Path(f"{file_name(load_robot(robot).name)}.{ending}")
    _save_text(export_robot(robot, to, profile, timestep=timestep), target)
    _print_tables([], [f"written: {make_visible(target)}"])


PROGRAM = {
    "list": list_robots,
    "check": check_robot,
    "new": _new,
    "import": _import,
    "export": _export,
}

if __name__ == "__main__":
    cli.run_command(PROGRAM, "python -m validation.robots")
