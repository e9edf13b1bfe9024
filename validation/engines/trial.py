"""A robot's turn on the spot in another engine, with the contacts that its file says."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from validation.descriptions.examination import Examined, own_physics
from validation.descriptions.findings import Finding
from validation.descriptions.foreign_robot import ForeignRobot
from validation.engines.drake import DrakeBody
from validation.engines.ode import GAZEBO, OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.simulator.calibration import Calibration
from validation.simulator.description import Robot, free_drive
from validation.simulator.turning import SPIN_LEAD, measure_spin, spin_on_spot

_RATE = 0.6
"""Commanded yaw rate [rad/s]."""
_TURNS = 1.3
"""Turns that mechanics expects [1]."""
_LONGEST = 40.0
"""Greatest duration of the turn [s]."""
_STEP = 0.001
"""Gazebo's physics step [s]."""


def examine_in_engine(robot: Robot, foreign: ForeignRobot | None, engine: str) -> Examined:
    """Turn a robot on the spot in ODE, with Gazebo's settings and its file's contacts, or in Drake.

    Where its friction depends on the heading, a cone is tried too.

    Raises:
        ValueError: the engine is not installed, or cannot have the robot.
        SsmrError: the simulation diverged.
    """
    calibration = Calibration.of(robot, timestep=min(robot.timestep, _STEP))
    if engine == "drake":
        return _examine_turn(_measure_turn(calibration, None), engine, [])
    settings = _ode_settings(foreign)
    calibration = Calibration.of(robot, wheel_shape="cylinder", timestep=_STEP)
    before = _measure_turn(calibration, settings)
    findings = []
    if settings.second_share != 1.0 or settings.direction == "wheel":
        cone = replace(settings, friction_law="cone", second_share=1.0)
        findings.append(
            Finding(
                "friction_by_heading",
                "fault",
                "friction of the wheels depends on the heading: Gazebo hands mu1, mu2 and fdir1 to "
                "ODE as a pyramid that rolls with the wheel",
                "give mu1 and mu2 one number, take fdir1 out, and take the cone as friction model",
                _turn_in_words(before),
                _turn_in_words(_measure_turn(calibration, cone)),
            )
        )
    return _examine_turn(before, engine, findings)


def _ode_settings(foreign: ForeignRobot | None) -> OdeSettings:
    """Return Gazebo's settings with the contacts of a file; without any, Gazebo's own."""
    contacts = [] if foreign is None else [numbers for numbers in foreign.contacts if numbers]
    first = contacts[0] if contacts else {}
    mu1 = first.get("mu1", 1.0)
    share = first.get("mu2", mu1) / mu1 if mu1 > 0.0 else 1.0
    return replace(
        GAZEBO,
        direction="wheel" if first.get("fdir1", 0.0) > 0.0 else "world",
        kp=first.get("kp", GAZEBO.kp),
        # those of tyre and ground act together
        kd=2.0 * first["kd"] if "kd" in first else GAZEBO.kd,
        second_share=share,
    )


def _measure_turn(calibration: Calibration, settings: OdeSettings | None) -> dict[str, float]:
    """Return measures of a turn on the spot in ODE; in Drake without settings."""
    robot = calibration.robot
    body = DrakeBody if settings is None else partial(OdeBody, settings=settings)
    name = "drake" if settings is None else "ode"
    # wheels that reach their rates, whatever that takes
    integral = robot.motor_drive.integral_gain
    drive = replace(free_drive(robot), integral_gain=integral, dc_stiffness=math.inf)
    plant = EnginePlant(name, body, calibration, drive)
    turn = _TURNS * 2.0 * math.pi * robot.turning_half_track / (0.5 * robot.track * _RATE)
    seconds = 0.05 * math.ceil(min(SPIN_LEAD + turn, _LONGEST) / 0.05)
    return measure_spin(spin_on_spot(plant, seconds, _RATE), calibration)


def _turn_in_words(measured: dict[str, float]) -> str:
    """Return a turn in words."""
    if "multiplier" not in measured:
        return "it does not turn once"
    lifted = 100.0 * measured["lifted_share"]
    return (
        f"turning ratio {measured['multiplier']:.2f}, yaw rate {100.0 * measured['ripple']:.0f} % "
        f"up and down over heading, a wheel off the ground {lifted:.0f} %"
    )


def _examine_turn(measured: dict[str, float], engine: str, findings: list[Finding]) -> Examined:
    """Return what a turn in an engine says."""
    measures = {
        "multiplier": measured.get("multiplier"),
        "closed_form": measured["multiplier_expected"],
        "sideways_m": measured["wander_m"],
        "lifted_share": measured["lifted_share"],
    }
    sentence = f"In {engine}, turning on the spot: {_turn_in_words(measured)}; by mechanics "
    sentence += f"{measured['multiplier_expected']:.2f}."
    numbers = own_physics(measures)
    numbers["own_physics"]["yaw_ripple"] = measured.get("ripple")
    return Examined([sentence], findings, numbers)
