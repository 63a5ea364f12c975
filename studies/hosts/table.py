"""The hosts: how each is installed, and what steps an export in it. docs/guide/hosts.md is made from this."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

PROGRAMS = Path(__file__).parent / "programs"
OWN = "cluttergen_jax"


@dataclass(frozen=True)
class Host:
    """One program that takes exports.

    Attributes:
      name: on the command line, and of its program in `programs`.
      title: its heading in docs/guide/hosts.md, or in docs/guide/export.md.
      format: of the export.
      packages: what pip is asked for, with pins.
      versions: of the packages that the table names.
      others: other objects in worlds side by side, in words for the table.
      trains: what was trained in it, in words for the table.
      python: the version that it needs, such as "3.12"; this one's if "".
    """

    name: str
    title: str
    format: str
    packages: tuple[str, ...]
    versions: tuple[str, ...]
    others: str
    trains: str = "-"
    python: str = ""

    @property
    def pip_line(self) -> str:
        """The one line that makes its environment, as the guide prints it; `.` is a checkout of ours."""
        return shlex.join(["pip", "install", *(each.replace(OWN, ".") for each in self.packages)])

    @property
    def program(self) -> Path:
        """What steps scenes in it."""
        return PROGRAMS / f"step_{self.name}.py"


_ALL = (
    Host(
        "mjlab",
        "mjlab",
        "mjlab",
        ("mjlab==1.6.0", "pyarrow"),
        ("mjlab", "mujoco", "mujoco-warp"),
        "yes",
        "PPO",
    ),
    Host(
        "playground",
        "MuJoCo Playground",
        "playground",
        ("playground==0.2.0", f"{OWN}[robot]"),
        ("playground", "mujoco-mjx", "warp-lang"),
        "yes",
        "not tried",
    ),
    Host(
        "newton",
        "Newton",
        "mjcf",
        ("newton[sim]==1.8.0", "trimesh", "scipy"),
        ("newton", "mujoco", "mujoco-warp"),
        "yes, as many in each",
    ),
    Host(
        "dm_control",
        "dm_control",
        "mjcf",
        ("dm_control==1.0.50", "mujoco==3.17.0"),
        ("dm_control", "mujoco"),
        "in each episode",
    ),
    Host(
        "robosuite",
        "robosuite",
        "robosuite",
        ("robosuite==1.5.2", "mujoco==3.3.7"),
        ("robosuite", "mujoco"),
        "in each environment",
    ),
    Host(
        "lerobot",
        "LeRobot, Gymnasium",
        "lerobot",
        ("lerobot==0.4.4", "mujoco==3.8.0", "pyarrow"),
        ("lerobot", "mujoco"),
        "yes",
        "ACT",
    ),
    Host(
        "maniskill",
        "ManiSkill 3",
        "maniskill",
        ("mani_skill==3.0.1", "torch"),
        ("mani_skill", "sapien"),
        "in each environment",
    ),
    Host("drake", "Drake", "sdf", ("drake==1.51.1",), ("drake",), "in each plant"),
    Host(
        "pybullet",
        "PyBullet",
        "urdf",
        ("pybullet==3.2.7", "numpy"),
        ("pybullet",),
        "in each client",
    ),
)
HOSTS = {each.name: each for each in _ALL}
"""Every host by name."""
