"""Robots that plain MuJoCo drives tell MuJoCo's friction by their torques, or the fit says why not.

Nothing of the project's simulator is in these robots: each is a text of MJCF with wheels of some
shape, motors that hold a speed, and contacts that do not hop. Sensors see its motion with noise of
2 mm, 2 mrad and 2 mrad/s, and torques with noise of 2 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from ssmr.types import FloatArray
from validation.files.csv_logs import write_csv
from validation.files.log import Log
from validation.fit import Fitted, fit

SECONDS = 75.0
PERIOD = 0.05
STEP = 0.002
SOFT = 'solimp="0.1 0.95 0.01"'
"""Contacts with which no wheel lifts; MuJoCo's own make wheels of such robots hop."""
NAMES = ("t", "enc_left", "enc_right", "x", "y", "yaw", "torque_left", "torque_right")


@dataclass(frozen=True)
class Rig:
    """A robot: kilograms and metres."""

    shape: str
    mass: float
    friction: float
    wheelbase: float
    track: float
    radius: float
    width: float
    ahead: float = 0.0
    """Distance of the centre of mass ahead of the middle [m]."""
    contact: str = SOFT

    @property
    def wheel_mass(self) -> float:
        """Return the mass of one wheel [kg]."""
        return 0.04 * self.mass

    def geom(self) -> str:
        """Return the attributes of a wheel's geom, whose axle is y."""
        lying = 'quat="0.70710678 0.70710678 0 0"'
        half = 0.5 * self.width
        return {
            "cylinder": f'type="cylinder" size="{self.radius} {half}" {lying}',
            "ellipsoid": f'type="ellipsoid" size="{self.radius} {self.radius} {half}" {lying}',
            "capsule": f'type="capsule" size="{self.radius} 0.005" {lying}',
            "mesh": 'type="mesh" mesh="wheel"',
        }[self.shape]

    def mesh(self) -> str:
        """Return the mesh of a wheel with 72 corners."""
        rim = self.radius * np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False))
        corners = [
            f"{z.real:.6f} {y} {z.imag:.6f}" for y in (-self.width / 2, self.width / 2) for z in rim
        ]
        return f'<asset><mesh name="wheel" vertex="{" ".join(corners)}"/></asset>'

    def model(self) -> str:
        """Return its MJCF."""
        surface = f'friction="{self.friction} 0 0" {self.contact}'
        m = self.wheel_mass
        across = 0.25 * m * self.radius**2 + m * self.width**2 / 12.0
        wheels = ""
        motors = ""
        for name, x, y in (("fl", 1, 1), ("fr", 1, -1), ("rl", -1, 1), ("rr", -1, -1)):
            wheels += (
                f'<body pos="{0.5 * x * self.wheelbase} {0.5 * y * self.track} 0">'
                f'<inertial pos="0 0 0" mass="{m}" '
                f'diaginertia="{across} {0.5 * m * self.radius**2} {across}"/>'
                f'<joint name="{name}" axis="0 1 0"/><geom {self.geom()} {surface}/></body>'
            )
            motors += f'<velocity joint="{name}" kv="{2.0 * self.mass * 9.81 * self.radius}"/>'
        base = self.mass - 4.0 * m
        x, y, z = self.wheelbase, 0.7 * self.track, 0.6 * self.radius
        inertia = f"{base / 12 * (y * y + z * z)} {base / 12 * (x * x + z * z)}"
        return (
            f'<mujoco><option timestep="{STEP}" integrator="implicitfast" cone="elliptic" '
            f'impratio="50"/>{self.mesh() if self.shape == "mesh" else ""}<worldbody>'
            f'<geom type="plane" size="0 0 1" {surface}/>'
            f'<body pos="0 0 {self.radius}"><freejoint/>'
            f'<inertial pos="{self.ahead * self.mass / base} 0 0.02" mass="{base}" '
            f'diaginertia="{inertia} {base / 12 * (x * x + y * y)}"/>{wheels}</body></worldbody>'
            f"<actuator>{motors}</actuator></mujoco>"
        )

    def description(self) -> str:
        """Return its robot's file, which says nothing of ground and tyres."""
        return (
            'schema = "ssmr.robot/1"\nname = "rig"\n[geometry]\n'
            f"wheelbase = {self.wheelbase}\ntrack = {self.track}\nwheel_radius = {self.radius}\n"
            f'wheel_width = {self.width}\nlink = "none"\n[mass]\ntotal = {self.mass}\n'
            f"wheel = {self.wheel_mass}\n"
        )


def drive(rig: Rig, seed: int) -> FloatArray:
    """Return (M, 8) columns of what perfect sensors see while it drives about at random."""
    model = mujoco.MjModel.from_xml_string(rig.model())
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    speeds = np.zeros(2)
    goal = np.zeros(2)
    change = 2.0
    rows = []
    for k in range(round(SECONDS / STEP)):
        if k * STEP >= change:
            change += rng.uniform(3.0, 4.5)
            ahead = rng.choice([0.0, 0.5, 0.5, -0.25]) * rng.uniform(0.5, 1.0)
            side = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.8)
            goal = np.array([ahead, 0.0 if ahead > 0.0 and rng.random() < 0.4 else side])
        speeds += np.clip(goal - speeds, [-STEP, -3.0 * STEP], [STEP, 3.0 * STEP])
        turn = 0.8 * rig.track * speeds[1]
        data.ctrl[:] = (speeds[0] + turn * np.array([-1.0, 1.0, -1.0, 1.0])) / rig.radius
        if k % round(PERIOD / STEP) == 0:
            w, _, _, z = data.qpos[3:7]
            wheels = data.qvel[6:].reshape(2, 2).mean(axis=0)
            torques = data.actuator_force.reshape(2, 2).sum(axis=0)
            rows.append([k * STEP, *wheels, *data.qpos[:2], 2.0 * math.atan2(z, w), *torques])
        mujoco.mj_step(model, data)
    return np.array(rows)


def fitted(rig: Rig, folder: Path, how: str = "plain") -> Fitted:
    """Return the fit to what sensors see of a robot; `how` says what is wrong with its torques."""
    table = drive(rig, round(10.0 * rig.mass))
    rng = np.random.default_rng([round(10.0 * rig.mass), 7])
    torques = table[:, 6:]
    usual = float(np.percentile(np.abs(torques), 90))
    torques += 0.02 * usual * rng.normal(size=torques.shape)
    if how == "late":
        torques[:] = np.vstack([np.repeat(torques[:1], 2, axis=0), torques[:-2]])
    if how == "scaled":
        torques *= 1.3
    if how in ("quantised", "coarse"):
        quantum = {"quantised": 0.1, "coarse": 0.5}[how] * usual
        torques[:] = quantum * np.round(torques / quantum)
    table[:, 1:6] += 0.002 * rng.normal(size=(len(table), 5))
    columns = dict(zip(NAMES, table.T.copy(), strict=True))
    if how == "missing":
        del columns["torque_left"], columns["torque_right"]
    if how == "one side":
        del columns["torque_right"]
    write_csv(Log.of_columns("log", columns), folder / "log.csv")
    (folder / "rig.toml").write_text(rig.description())
    return fit("mujoco", folder / "log.csv", robot=folder / "rig.toml", input="wheels", seed=1)


RIGS = {
    "cylinder 15": (Rig("cylinder", 15.0, 0.9, 0.30, 0.38, 0.10, 0.05), "plain"),
    "capsule 20": (Rig("capsule", 20.0, 0.3, 0.35, 0.40, 0.11, 0.05, ahead=0.03), "late"),
    "ellipsoid 30": (Rig("ellipsoid", 30.0, 0.2, 0.45, 0.50, 0.14, 0.08, ahead=0.02), "quantised"),
    "capsule 45": (Rig("capsule", 45.0, 0.55, 0.50, 0.55, 0.16, 0.06), "coarse"),
    "mesh 60": (Rig("mesh", 60.0, 0.65, 0.50, 0.60, 0.165, 0.11), "plain"),
    "cylinder 100": (Rig("cylinder", 100.0, 1.1, 0.70, 0.80, 0.20, 0.12, ahead=-0.03), "plain"),
    "ellipsoid 150": (Rig("ellipsoid", 150.0, 0.45, 0.80, 0.90, 0.22, 0.15), "missing"),
    "mesh 250": (Rig("mesh", 250.0, 0.8, 1.0, 1.1, 0.28, 0.2), "late"),
}
"""Robots, and what is wrong with their torques."""


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGS)
def test_friction_comes_back_within_three_errors_or_is_held_and_said(
    tmp_path: Path, name: str
) -> None:
    rig, how = RIGS[name]
    found = fitted(rig, tmp_path, how)
    own = [p for p in found.parameters if p.name == "friction"]
    assert bool(own) == (how not in ("coarse", "missing"))
    assert any(note.startswith("friction is held at") for note in found.notes()) != bool(own)
    for p in own:
        assert p.standard_error is not None
        off = abs(p.value - rig.friction)
        print(f"{name} {how}: {p.value:.4f} ± {p.standard_error:.4f} for {rig.friction}")
        assert off <= 0.03
        assert off <= 3.0 * p.standard_error
    assert not any("hop" in note for note in found.notes())


@pytest.mark.slow
def test_what_a_wrong_scale_does_to_friction_is_said(tmp_path: Path) -> None:
    """No motion tells it: a robot on ground of more friction has these torques."""
    rig, _ = RIGS["ellipsoid 150"]
    found = fitted(rig, tmp_path, "scaled")
    (friction,) = (p.value for p in found.parameters if p.name == "friction")
    assert friction == pytest.approx(1.3 * rig.friction, abs=0.03)
    assert any("a scale that is off by a share makes friction wrong" in n for n in found.notes())


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["cylinder", "ellipsoid"])
def test_a_robot_that_hops_is_named(tmp_path: Path, shape: str) -> None:
    """With MuJoCo's own contacts wheels hop, and the robot turns half as much as it should."""
    rig = replace(RIGS["mesh 60"][0], shape=shape, friction=0.7, contact="")
    notes = fitted(rig, tmp_path).notes()
    assert any("times as much for a turn" in note and "hop" in note for note in notes)
