"""Drive-train study: a real robot's driver, friction, losses and inertia, from commands, rates and currents in its logs.

docs/drivetrain.md explains it. A log of wheels in the air tells the driver and, with currents, the inertia; one of the
ground tells friction, losses and slip.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, get_args

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.parameters import require_within
from validation import cli
from validation.files.log import Log
from validation.identify.currents import CurrentFit, fit_currents
from validation.identify.motor_logs import (
    FIT_SHARE,
    Chassis,
    chassis_of,
    drive_log,
    require_currents,
    sampled_in_windows,
)
from validation.plants.profile import choose_profile
from validation.progress import Progress
from validation.report import drawing
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Row, Table
from validation.simulator.description import GRAVITY
from validation.study.drivetrain_fit import (
    LEAST_COMMANDS,
    DriverFit,
    InertiaFit,
    fit_driver,
    fit_inertia,
)
from validation.study.drivetrain_logs import held_commands, rate_evidence
from validation.study.sweep import StudyOptions, picture

_USUAL_RHO = 0.145  # resistance over voltage constant of a Husky's motors, where no log on the ground tells it [rad/s per A]
_INERTIA_DRAWS = (
    10  # draws of the transients for each one of the other bootstraps: they cost next to nothing
)
_DRIVER = {
    "dead_time": ("s", "from a command to the driver's set point"),
    "gain": ("1", "rim speed over commanded speed"),
    "half_track": ("m", "half-track with which the driver turns yaw rates into rim speeds"),
    "yaw_rate_limit": ("rad/s", "greatest yaw rate that is obeyed"),
    "acceleration": ("m/s²", "greatest change of the commanded speed"),
    "yaw_acceleration": ("rad/s²", "greatest change of the commanded yaw rate"),
    "lag": ("s", "time constant of the rims"),
}
_FRICTION = {
    "friction": ("friction_current", "friction_torque", "friction torque on one side"),
    "loss_left": ("loss_left", "loss_torque_left", "losses, left"),
    "loss_right": ("loss_right", "loss_torque_right", "losses, right"),
}
"""Names of the numbers as currents and as torques, and what they are."""
_MORE = {
    "slip_scale": ("1", "slip at which 63 % of the friction acts"),
    "rho": ("rad/s per A", "motors' resistance over voltage constant"),
    "heat": ("W/(N m)²", "motors' resistance over torque constant squared"),
    "efficiency": ("1", "share of the power that passes the gear, either way"),
}


@dataclass(frozen=True, kw_only=True)
class DriveTrainStudy(StudyOptions):
    """Options of the study of a drive train."""

    recording: Annotated[str | Log | None, cli.text_of("PATH"), cli.option(default="none")] = None
    """Path of a recording with commands and wheel rates, the robot standing with its wheels in the air; with currents, it
    tells the inertia too."""
    ground: Annotated[str | Log | None, cli.text_of("PATH"), cli.option(default="none")] = None
    """Path of a recording on the ground with wheel rates and currents (current_left, current_right)."""
    held_out: Annotated[
        tuple[str | Log, ...],
        get_args(cli.Names)[1],
        cli.option(metavar="PATH,...", default="none"),
    ] = ()
    """Paths of recordings that only judge: those with a heading or a gyro the currents, others the wheel rates. Without
    any, the last third of each log judges what is fitted to the rest."""
    torque_constant: Annotated[cli.Number, cli.option(metavar="K", default="unknown")] = None
    """Torque of one side's wheels per ampere of its motor [N m/A], where it is known."""
    resamples: int = 60
    """Number of fits to resampled data, from which standard errors are taken."""
    profile: Annotated[cli.AnyProfile, cli.profile_option("husky-tile")] = None
    mass: Annotated[cli.Number, cli.option(metavar="KG", default="the profile's")] = None
    """Total mass with payload, where it is not the profile's [kg]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for numbers out of range."""
        super().__post_init__()
        require_within(self, ("torque_constant", "mass"), 1e-6, 1e6)
        require_within(self, ("resamples",), 2, 100_000, whole=True)


def _parameters(
    driver: DriverFit | None,
    currents: CurrentFit | None,
    inertia: InertiaFit | None,
    chassis: Chassis,
    k: float | None,
) -> dict[str, Row]:
    """Return value, standard error, unit and meaning of every number that was found, by name.

    What currents tell are currents where they are the motors', and torques where they are the battery's; the torque constant
    `k` [N m/A] makes one of the other.
    """
    rows = {} if currents is None else _of_currents(currents, chassis, k)
    if inertia is not None:
        value, error = inertia.value, inertia.standard_error
        rows["inertia_current"] = _row(
            value, error, "A s²/rad", "inertia on one side over torque constant"
        )
        if k is not None:
            rows["rotor_inertia"] = _row(
                k * value, k * error, "kg m²", "inertia on one side, at its wheels"
            )
    if driver is not None:
        for (key, words), value, error in zip(
            _DRIVER.items(), driver.law, driver.errors, strict=True
        ):
            if key != "yaw_rate_limit" or driver.limit_reached:
                rows[f"driver_{key}"] = _row(value, error, *words)
    return rows


def _of_currents(fit: CurrentFit, chassis: Chassis, k: float | None) -> dict[str, Row]:
    rows, x, e = dict[str, Row](), fit.numbers, fit.errors
    motor = fit.kind == "motor"
    ampere, torque = (1.0, k) if motor else (None if k is None else 1.0 / k, 1.0)
    for key, (as_current, as_torque, meaning) in _FRICTION.items():
        if ampere is not None:
            rows[as_current] = _row(
                ampere * x[key], ampere * e[key], "A", f"{meaning}, over torque constant"
            )
        if torque is not None:
            rows[as_torque] = _row(torque * x[key], torque * e[key], "N m", meaning)
    if torque is not None:
        share = torque / (0.5 * chassis.mass * GRAVITY * chassis.geometry.radius)
        words = f"friction coefficient with {chassis.mass:g} kg"
        rows["friction"] = _row(share * x["friction"], share * e["friction"], "1", words)
    return rows | {key: _row(x[key], e[key], *words) for key, words in _MORE.items() if key in x}


def _row(value: float, error: float, unit: str, meaning: str) -> Row:
    return {"value": value, "standard_error": error, "unit": unit, "meaning": meaning}


@cli.program(DriveTrainStudy)
def study_drivetrain(o: DriveTrainStudy) -> Report:
    """Estimate what a robot's driver makes of commands, and its friction, losses and inertia, from its logs.

    Raises:
        ValueError: there is no log or no such robot, a log cannot be read, or one lacks what is needed.
    """
    up, ground = (
        None if source is None else drive_log(source) for source in (o.recording, o.ground)
    )
    held_out = [drive_log(source) for source in o.held_out]
    named = [log for log in (up, ground) if log is not None]
    if not named:
        raise ValueError(
            "the drive train needs a log: recording (wheels in the air), ground, or both"
        )
    if ground is not None:
        require_currents(ground)
    chassis = chassis_of(choose_profile(o.profile, o.robot, "husky-tile"), o.mass)
    commanded = up or (ground if len(held_commands(named[0])) >= 2 * LEAST_COMMANDS else None)
    alike = [
        log for log in held_out if commanded is not None and log.on_ground == commanded.on_ground
    ]
    driven = [
        log for log in held_out if ground is not None and log.on_ground and log.currents is not None
    ]
    for log in held_out:
        if log not in (*alike, *driven):
            where = (
                "on the ground"
                if log.on_ground
                else "with its wheels in the air (it has no heading)"
            )
            raise ValueError(
                f"held_out {log.name} was taken {where}, and no log of that kind is studied"
            )
    driver, currents, inertia, status = None, None, None, FINISHED
    try:
        if commanded is not None:
            others = [log for log in named if log is not commanded]
            driver = fit_driver(commanded, alike, others, chassis, o.seed, o.resamples)
            o.progress(Progress(1, 3, "commands and wheel rates"))
        if ground is not None:
            currents = fit_currents(ground, driven, chassis, o.seed, o.resamples)
            o.progress(Progress(2, 3, "currents on the ground"))
        if (
            driver is not None
            and up is not None
            and up.currents is not None
            and not (up.on_ground or up.signed)
        ):
            rho = _USUAL_RHO if currents is None else currents.numbers.get("rho", _USUAL_RHO)
            inertia = fit_inertia(
                up, driver.law, chassis, rho, o.seed, _INERTIA_DRAWS * o.resamples
            )
            o.progress(Progress(3, 3, "inertia"))
    except KeyboardInterrupt:
        if driver is None and currents is None:
            raise
        status = INTERRUPTED
    numbers = _parameters(driver, currents, inertia, chassis, o.torque_constant)
    evidence = [rate_evidence(log)._asdict() for log in (*named, *held_out)]
    source = next((fit.log for fit in (driver, currents) if fit is not None), None)
    document = {
        "schema": "ssmr.study/1", "study": "drivetrain",
            "robot": {**chassis._asdict(), "geometry": chassis.geometry._asdict()},
        "wheel_rate_rms_rad_s": None if driver is None else driver.rms,
        "current_r2": None if currents is None else currents.best["held_out"],
        "current_r2_samples": None if currents is None else currents.best["samples"],
        "current_is": None if currents is None else currents.kind,
        "wheel_rates_are": next((e["wheel_rates_are"] for e in evidence if e["log"] == source), None),
        "parameters": numbers,
        "inertia": None if inertia is None else {**inertia.estimates, "n": inertia.n},
        "samples": None if currents is None or ground is None else {
            "kind": "windows" if sampled_in_windows(ground) else "values", **currents.sensor._asdict()
        },
        "held_out_share": 0.0 if o.held_out else 1.0 - FIT_SHARE,
        "torque_constant_N_m_A": o.torque_constant,
    }  # fmt: skip
    return Report(
        program="study", title=f"Drive train of {chassis.name}: {', '.join(log.name for log in named)}", document=document,
        tables=[
            Table("Numbers", [{"number": name, **row} for name, row in numbers.items()], "From the whole of each log."),
            Table("Wheel rates from commands", [] if driver is None else driver.scores, "rms: after held commands."),
            Table("What the currents show", [] if currents is None else currents.scores, _CURRENTS),
            Table("Whether wheel rates are measured", evidence, _RATES),
        ],
        sentences=_sentences(o, chassis, currents), status=status, draw=partial(_draw, driver, currents), has_text=True,
        options={"resamples": o.resamples, "seed": o.seed, "robot": chassis.name, "mass": chassis.mass},
    )  # fmt: skip


_CURRENTS = (
    "Share of the variance of the currents in steady driving that is explained, R², if they are those of the rule.\n"
    "samples: of what was held out, sample by sample."
)
_RATES = (
    "scatter: median standard deviation of a wheel rate long after a held command.\n"
    "step: of which all rates are multiples. Rates that do not scatter, or that come in steps, are the driver's set points."
)


def _sentences(o: DriveTrainStudy, chassis: Chassis, currents: CurrentFit | None) -> list[str]:
    says = []
    if o.robot is None and o.profile is None:
        says.append(f"No robot was named: the logs are taken for those of a {chassis.name}.")
    if currents is not None and currents.kind == "motor" and o.torque_constant is None:
        says.append(
            "Unknown without torque_constant: friction torque, friction coefficient and inertia of the rotors."
        )
    if currents is not None and currents.kind == "battery":
        says.append(
            f"Power fixes the torques' scale; the friction coefficient is as good as the mass, {chassis.mass:g} kg."
        )
    return says


def _draw(driver: DriverFit | None, currents: CurrentFit | None, study: Report) -> Figure:
    def draw_rates(ax: Axes) -> None:
        assert driver is not None
        t, logged, predicted = driver.shown
        for side, name in enumerate(("left", "right")):
            ax.plot(t, logged[side], color="0.55", linewidth=3.5, alpha=0.6, gid="logged")
            ax.plot(
                t,
                predicted[side],
                color=f"C{side}",
                linewidth=1.3,
                gid="predicted",
                label=f"predicted, {name}",
            )
        ax.set(
            title=f"Wheel rates from commands, held out: {driver.rms:.3f} rad/s rms",
            xlabel="time [s]",
            ylabel="rad/s",
        )
        ax.legend(fontsize=8.0)

    def draw_currents(ax: Axes) -> None:
        assert currents is not None
        for (measured, predicted), name in zip(currents.shown, ("fitted", "held out"), strict=True):
            ax.plot(measured, predicted, "o", markersize=5.0, alpha=0.8, label=name)
        ax.axline((0.0, 0.0), slope=1.0, color="0.2", linewidth=0.8, linestyle=drawing.DASHED)
        ax.set(title="Currents in steady driving", xlabel="measured [A]", ylabel="predicted [A]")
        ax.legend(fontsize=8.0)

    known = ((driver, 2.6, draw_rates), (currents, 3.4, draw_currents))
    return picture(
        study,
        [drawing.side_by_side(height, [draw]) for fit, height, draw in known if fit is not None],
    )
