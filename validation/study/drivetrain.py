"""Drive-train study: driver, friction, losses and inertia of a real robot, from its logs.

docs/drivetrain.md explains it. A log of wheels in the air tells the driver and, with currents, the
inertia; one of the ground tells friction, losses and slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from ssmr.parameters import require_within
from ssmr.types import FloatArray
from validation import cli
from validation.files.log import Log
from validation.identify.blocks import values_of
from validation.identify.currents import CurrentFit, fit_currents
from validation.identify.driver import (
    LEAST_COMMANDS,
    DriverFit,
    fit_driver,
    fit_inertia,
    held_commands,
    rate_evidence,
)
from validation.identify.motor_logs import (
    FIT_SHARE,
    DriveLog,
    chassis_of,
    drive_log,
    require_currents,
)
from validation.output import Document, Progress
from validation.plants.kind import PlantProfile
from validation.plants.profile import choose_profile
from validation.report import drawing
from validation.report.report import FINISHED, INTERRUPTED
from validation.report.table import Row, Table
from validation.simulator.description import GRAVITY
from validation.study.common import Study, StudyOptions

# resistance over voltage constant of a Husky's motors, where no log on the ground tells it [rad/s
# per A]
_USUAL_RHO = 0.145
_SHOWN = 45.0  # length of the stretch in the picture [s]
_MEANINGS = {
    "driver_dead_time": ("s", "from a command to the driver's set point"),
    "driver_gain": ("1", "rim speed over commanded speed"),
    "driver_half_track": ("m", "half-track with which the driver turns yaw rates into rim speeds"),
    "driver_yaw_rate_limit": ("rad/s", "greatest yaw rate that is obeyed"),
    "driver_acceleration": ("m/s²", "greatest change of the commanded speed"),
    "driver_yaw_acceleration": ("rad/s²", "greatest change of the commanded yaw rate"),
    "driver_lag": ("s", "time constant of the rims"),
    "friction_current": ("A", "friction torque on one side, over torque constant"),
    "loss_left": ("A", "losses, left, over torque constant"),
    "loss_right": ("A", "losses, right, over torque constant"),
    "friction_torque": ("N m", "friction torque on one side"),
    "loss_torque_left": ("N m", "losses, left"),
    "loss_torque_right": ("N m", "losses, right"),
    "friction": ("1", "friction coefficient with the robot's mass"),
    "slip_scale": ("1", "slip at which 63 % of the friction acts"),
    "rho": ("rad/s per A", "motors' resistance over voltage constant"),
    "heat": ("W/(N m)²", "motors' resistance over torque constant squared"),
    "efficiency": ("1", "share of the power that passes the gear, either way"),
    "inertia_current": ("A s²/rad", "inertia on one side over torque constant"),
    "rotor_inertia": ("kg m²", "inertia on one side, at its wheels"),
}
"""Every number of the study by its name: its unit, and what it is."""
_SCALED = {
    "friction_current": "friction_torque",
    "loss_left": "loss_torque_left",
    "loss_right": "loss_torque_right",
    "inertia_current": "rotor_inertia",
}
"""Names of numbers as currents and as torques: the torque constant makes one of the other."""


_CURRENTS = (
    "Share of the variance of the currents in steady driving that is explained, R², "
    "if they are those of the rule.\n"
    "samples: of what was held out, sample by sample."
)
_MEASURED = "Whether wheel rates are measured"
_RATES = (
    "scatter: median standard deviation of a wheel rate long after a held command.\n"
    "step: of which all rates are multiples. "
    "Rates that do not scatter, or that come in steps, are the driver's set points."
)


@dataclass(frozen=True, kw_only=True)
class DriveTrainStudy(StudyOptions):
    """Options of the study of a drive train."""

    recording: str | Log | None = None
    """Path of a recording with commands and wheel rates, the robot standing with its wheels in the
    air; with currents, it tells the inertia too."""
    ground: str | Log | None = None
    """Path of a recording on the ground with wheel rates and currents (current_left,
    current_right)."""
    held_out: Sequence[str | Log] = ()
    """Paths of recordings that only judge: those with a heading or a gyro the currents, others the
    wheel rates. Without any, the last third of each log judges what is fitted to the rest."""
    torque_constant: float | None = None
    """Torque of one side's wheels per ampere of its motor [N m/A], where it is known."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, husky-tile, and for
    another --robot the numbers of its file."""
    mass: float | None = None
    """Total mass with payload, where it is not the profile's [kg]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for numbers out of range."""
        super().__post_init__()
        require_within(self, ("torque_constant", "mass"), 1e-6, 1e6)


def _scaled_numbers(
    found: dict[str, FloatArray], chassis: PlantProfile, constant: float | None
) -> dict[str, Row]:
    """Return value, standard error, unit and meaning of every number that was found, by name.

    The torque constant [N m/A] makes torques of currents, and currents of torques; the weight makes
    a friction coefficient of a torque.
    """
    if constant is not None:
        for current, torque in _SCALED.items():
            if current in found:
                found[torque] = constant * found[current]
            elif torque in found:
                found[current] = found[torque] / constant
    if "friction_torque" in found:
        most = 0.5 * chassis.vehicle.mass * GRAVITY * chassis.vehicle.wheel_radius
        found["friction"] = found["friction_torque"] / most
    numbers = dict[str, Row]()
    for name, (unit, meaning) in _MEANINGS.items():
        if name in found:
            value, error = found[name]
            row = {"value": value, "standard_error": error, "unit": unit, "meaning": meaning}
            numbers[name] = row
    return numbers


def _judging_logs(
    held_out: Sequence[DriveLog], commanded: DriveLog | None, ground: DriveLog | None
) -> tuple[list[DriveLog], list[DriveLog]]:
    """Return what judges the driver, and the currents; a ValueError names a log of no use."""
    alike = [log for log in held_out if commanded and log.on_ground == commanded.on_ground]
    driven = [log for log in held_out if ground and log.on_ground and log.currents.size]
    for log in held_out:
        if log not in (*alike, *driven):
            where = "with its wheels in the air (it has no heading)"
            if log.on_ground:
                where = "on the ground"
            raise ValueError(
                f"held_out {log.name} was taken {where}, and no log of that kind is studied"
            )
    return alike, driven


@cli.make_program(DriveTrainStudy)
def study_drivetrain(o: DriveTrainStudy) -> Study:
    """Estimate a robot's driver, friction, losses and inertia from its logs.

    Raises:
        ValueError: there is no log or no such robot, a log cannot be read, or one lacks what is
            needed.
    """
    up = None if o.recording is None else drive_log(o.recording)
    ground = None if o.ground is None else drive_log(o.ground)
    named = [log for log in (up, ground) if log is not None]
    if not named:
        raise ValueError(
            "the drive train needs a log: recording (wheels in the air), ground, or both"
        )
    if ground is not None:
        require_currents(ground)
    chassis = chassis_of(choose_profile(o.profile, o.robot, "husky-tile"), o.mass)
    commanded = up or (ground if len(held_commands(named[0])) >= 2 * LEAST_COMMANDS else None)
    held_out = [drive_log(source) for source in o.held_out]
    alike, driven = _judging_logs(held_out, commanded, ground)
    driver = None
    currents = None
    inertia = None
    kind = None
    found: dict[str, FloatArray] = {}
    status = FINISHED
    try:
        if commanded is not None:
            others = [log for log in named if log is not commanded]
            driver = fit_driver(commanded, alike, others, chassis)
            for name, pair in driver.found.items():
                # no command asks for more than a limit that nothing depends on
                found |= {f"driver_{name}": pair} if pair[1] > 1e-9 else {}
            o.progress(Progress(1, 3, "commands and wheel rates"))
        if ground is not None:
            currents = fit_currents(ground, driven, chassis)
            kind = currents.best["kind"]
            for name, pair in currents.found.items():
                key = "friction_current" if name == "friction" else name
                # what a battery's currents tell are torques
                found[_SCALED.get(key, key) if kind == "battery" else key] = pair
            o.progress(Progress(2, 3, "currents on the ground"))
        if driver and up and up.currents.size and not (up.on_ground or up.signed):
            shown = {} if currents is None else values_of(currents.found)
            rho = shown.get("rho", _USUAL_RHO)
            inertia = fit_inertia(driver, rho)
            found |= {} if inertia is None else {"inertia_current": inertia[0]}
            o.progress(Progress(3, 3, "inertia"))
    except KeyboardInterrupt:
        if not (driver or currents):
            raise
        status = INTERRUPTED
    numbers = _scaled_numbers(found, chassis, o.torque_constant)
    evidence = [rate_evidence(log) for log in (*named, *held_out)]
    return Study(
        title=f"Drive train of {chassis.robot.name}: {', '.join(log.name for log in named)}",
        about={
            "schema": "ssmr.study/1",
            "study": "drivetrain",
            "robot": _robot_document(chassis),
            "wheel_rate_rms_rad_s": driver and driver.rms,
            "current_r2": currents and currents.best["held_out"],
            "current_r2_samples": currents and currents.best["samples"],
            "current_is": kind,
            "wheel_rates_are": evidence[0]["wheel_rates_are"],
            "parameters": numbers,
            "inertia": inertia and inertia[1],
            "samples": currents and currents.sensor._asdict(),
            "held_out_share": 0.0 if o.held_out else 1.0 - FIT_SHARE,
            "torque_constant_N_m_A": o.torque_constant,
        },
        shown=[*_make_tables(numbers, driver, currents), Table(_MEASURED, evidence, _RATES)],
        remarks=_write_sentences(o, chassis, kind),
        status=status,
        panels=_draw_panels(driver, currents),
        options={"seed": o.seed, "robot": chassis.robot.name, "mass": chassis.vehicle.mass},
    )


def _make_tables(
    numbers: dict[str, Row], driver: DriverFit | None, currents: CurrentFit | None
) -> list[Table]:
    """Return the numbers, and how well they predict the logs."""
    rows = [{"number": name, **row} for name, row in numbers.items()]
    rates = driver.scores if driver else []
    return [
        Table("Numbers", rows, "From the whole of each log."),
        Table("Wheel rates from commands", rates, "rms: after held commands."),
        Table("What the currents show", currents.scores if currents else [], _CURRENTS),
    ]


def _draw_panels(driver: DriverFit | None, currents: CurrentFit | None) -> list[drawing.PanelRow]:
    panels = []
    if driver is not None:
        panels.append(drawing.PanelRow(2.6, [partial(_draw_rates, driver)]))
    if currents is not None:
        panels.append(drawing.PanelRow(3.4, [partial(_draw_currents, currents)]))
    return panels


def _robot_document(chassis: PlantProfile) -> Document:
    """Return the nominal numbers of the robot, as study.json has them."""
    sizes = chassis.vehicle
    return {
        "name": chassis.robot.name,
        "mass": sizes.mass,
        "command_radius": chassis.drive.command_radius,
        "speed_limit": chassis.drive.v_max,
        "geometry": {
            "radius": sizes.wheel_radius,
            "half_track": sizes.half_track,
            "half_base": sizes.a,
        },
    }


def _write_sentences(o: DriveTrainStudy, chassis: PlantProfile, kind: str | None) -> list[str]:
    """Return what its user has to know; `kind` is whose currents the log has."""
    says = []
    if o.robot is None and o.profile is None:
        says.append(f"No robot was named: the logs are taken for those of a {chassis.robot.name}.")
    if kind == "motor" and o.torque_constant is None:
        says.append(
            "Unknown without torque_constant: friction torque, friction coefficient and "
            "inertia of the rotors."
        )
    if kind == "battery":
        says.append(
            "Power fixes the torques' scale; the friction coefficient is as good as the mass, "
            f"{chassis.vehicle.mass:g} kg."
        )
    return says


def _draw_rates(driver: DriverFit, ax: Axes) -> None:
    t, logged, predicted = driver.shown
    begin = t[np.abs(logged).any(axis=0)][0]
    inside = (t >= begin) & (t < begin + _SHOWN)
    look: Document = {"color": "0.55", "linewidth": 3.5, "alpha": 0.6}
    ax.plot(t[inside], logged[:, inside].T, gid="logged", label=["as logged", "_"], **look)
    for side, name in enumerate(("left", "right")):
        ax.plot(t[inside], predicted[side, inside], gid="predicted", label=f"predicted, {name}")
    title = f"Wheel rates from commands, held out: {driver.rms:.3f} rad/s rms"
    ax.set(title=title, xlabel="time [s]", ylabel="rad/s")
    ax.legend(fontsize=8.0)


def _draw_currents(currents: CurrentFit, ax: Axes) -> None:
    for (measured, predicted), name in zip(currents.shown, ("fitted", "held out"), strict=True):
        ax.plot(measured.ravel(), predicted.ravel(), "o", markersize=5.0, alpha=0.8, label=name)
    ax.axline((0.0, 0.0), slope=1.0, color="0.2", linewidth=0.8, linestyle=drawing.DASHED)
    ax.set(title="Currents in steady driving", xlabel="measured [A]", ylabel="predicted [A]")
    ax.legend(fontsize=8.0)
