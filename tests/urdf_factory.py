"""URDFs of four-wheeled robots with known numbers, with names, order and frames as in the wild."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

CORNERS = {
    "front_left": (1, 1),
    "front_right": (1, -1),
    "rear_left": (-1, 1),
    "rear_right": (-1, -1),
}


@dataclass(frozen=True)
class UrdfRobot:
    """The numbers of a robot, and how its file writes them."""

    wheelbase: float = 0.5
    track: float = 0.6
    radius: float = 0.15
    width: float = 0.1
    axle: float = 0.03
    mass: float = 40.0
    com: tuple[float, float, float] = (0.02, -0.01, 0.05)
    inertia: tuple[float, float, float] = (0.8, 1.2, 1.6)
    wheel: float = 2.0
    names: Sequence[str] = tuple(CORNERS)
    """Names of the wheels' links, front left, front right, rear left, rear right."""
    order: Sequence[int] = (0, 1, 2, 3)
    """In which the wheels are written."""
    axes: Sequence[tuple[float, float, float]] = ((0, 1, 0),) * 4
    """Axes of the joints in the wheels' frames, which `rolls` turn about x [rad]."""
    rolls: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
    drums: bool = True
    """Whether the tyres have cylinders of collision; else there are meshes alone."""
    more: str = ""
    """More links and joints."""
    lumps: Sequence[tuple[float, float, float]] = field(default=((0.0, 0.0, 0.0),))
    """Where equal parts of the body's mass lie, around its centre [m]; their mean must be zero."""

    def spin(self) -> tuple[float, float]:
        """Return a wheel's moments of inertia about a diameter and its axle: a solid cylinder's."""
        return self.wheel * (
            3.0 * self.radius**2 + self.width**2
        ) / 12.0, 0.5 * self.wheel * self.radius**2

    def _body(self) -> str:
        each = self.mass / len(self.lumps)
        away = np.array(self.lumps)
        spread = each * sum((p @ p * np.eye(3) - np.outer(p, p) for p in away), np.zeros((3, 3)))
        own = (np.diag(self.inertia) - spread) / len(self.lumps)
        parts = ['<link name="base_link"/>']
        for k, p in enumerate(away):
            x, y, z = np.add(self.com, p).tolist()
            keys = {
                "ixx": (0, 0),
                "ixy": (0, 1),
                "ixz": (0, 2),
                "iyy": (1, 1),
                "iyz": (1, 2),
                "izz": (2, 2),
            }
            tensor = " ".join(
                f'{key}="{own[at]!r}"'.replace("np.float64(", "").replace(")", "")
                for key, at in keys.items()
            )
            parts.append(
                f'<link name="part{k}"><inertial><origin xyz="0 0 {z}"/><mass value="{each}"/>'
                f"<inertia {tensor}/></inertial></link>"
                f'<joint name="part{k}_joint" type="fixed"><parent link="base_link"/>'
                f'<child link="part{k}"/>'
                f'<origin xyz="{x} {y} 0"/></joint>'
            )
        return "".join(parts)

    def _wheel(self, k: int) -> str:
        name, (front, left) = self.names[k], list(CORNERS.values())[k]
        x = 0.5 * front * self.wheelbase
        y = 0.5 * left * self.track
        across, spin = self.spin()
        # the wheel's own frame is turned about x; its shape and inertia are turned back
        roll = self.rolls[k]
        mesh = '<geometry><mesh filename="package://nowhere/wheel.dae"/></geometry>'
        cylinder = f'<geometry><cylinder radius="{self.radius}" length="{self.width}"/></geometry>'
        shape = f"<visual>{mesh}</visual><collision>{mesh}</collision>"
        if self.drums:
            turned = f'<origin xyz="0 0 0" rpy="{0.5 * math.pi - roll} 0 0"/>'
            shape = f"<visual>{mesh}</visual><collision>{turned}{cylinder}</collision>"
        return (
            f'<link name="{name}"><inertial><origin rpy="{-roll} 0 0"/><mass value="{self.wheel}"/>'
            f'<inertia ixx="{across}" ixy="0" ixz="0" iyy="{spin}" iyz="0" izz="{across}"/>'
            f"</inertial>{shape}</link>"
            f'<joint name="{name}_joint" type="continuous"><parent link="base_link"/>'
            f'<child link="{name}"/>'
            f'<origin xyz="{x} {y} {self.axle}" rpy="{roll} 0 0"/>'
            f'<axis xyz="{" ".join(map(str, self.axes[k]))}"/></joint>'
        )

    def text(self) -> str:
        """Return the URDF."""
        wheels = "".join(self._wheel(k) for k in self.order)
        return (
            f'<?xml version="1.0"?><robot name="factory">{wheels}{self._body()}{self.more}</robot>'
        )


def extra_wheel(
    name: str,
    x: float,
    y: float,
    parent: str = "base_link",
    axis: str = "0 1 0",
    kind: str = "continuous",
) -> str:
    """Return one more wheel, for `UrdfRobot.more`."""
    return (
        f'<link name="{name}"><inertial><mass value="1"/>'
        f'<inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial></link>'
        f'<joint name="{name}_joint" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{x} {y} 0.03"/><axis xyz="{axis}"/>'
        '<limit lower="-0.4" upper="0.4" effort="1" velocity="1"/></joint>'
    )
