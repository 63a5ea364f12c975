"""The commands by name, where none of them is imported: `cluttergen --help` has only this to read."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from importlib import import_module
from operator import or_
from typing import Annotated, Any


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
      module: in `cluttergen_jax.cli`; importing it imports no JAX and no MuJoCo.
      name: of its class there, whose fields are the options.
      about: the first line of that class's docstring.
    """

    module: str
    name: str
    about: str

    def load(self) -> Any:
        """The class."""
        return getattr(import_module(f"cluttergen_jax.cli.{self.module}"), self.name)


COMMANDS = {
    "generate": Command(
        "generate", "Generate", "Generate verified cluttered scenes and save them as a bank."
    ),
    "verify": Command(
        "verify",
        "Verify",
        "Check that saved scenes stand: plain MuJoCo, everything awake. Exit status 1 if one does not.",
    ),
    "export": Command(
        "export", "Export", "Write scenes of a bank as a self-contained folder for another program."
    ),
    "certify": Command(
        "certify",
        "Certify",
        "Add a stability certificate to each scene of a bank that stands, a column for each measure.",
    ),
    "stats": Command(
        "stats",
        "Stats",
        "Show what a bank holds: successes, verdicts, objects, attempts, duplicates, what is missing.",
    ),
    "push": Command(
        "push",
        "Push",
        "Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.",
    ),
    "pull": Command(
        "pull", "Pull", "Fetch a bank from the Hugging Face Hub (extra `hub`) and check every file of it."
    ),
    "view": Command(
        "view",
        "View",
        "Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.",
    ),
    "render": Command(
        "render",
        "Render",
        "Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure.",
    ),
    "train": Command(
        "train",
        "Train",
        "Train a placement policy with PPO. The same command takes an interrupted run up again.",
    ),
    "pretrain": Command(
        "pretrain",
        "Pretrain",
        "Pretrain a point encoder by classifying shapes. The same command takes an interrupted run up again.",
    ),
    "evaluate": Command(
        "evaluate",
        "Evaluate",
        "Compare methods on pools and supports, or make a suite of tables and figures (`--suite`).",
    ),
    "import": Command(
        "import_",
        "Import",
        "Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, MJCF, folders, or `ycb`.",
    ),
    "pool": Command(
        "pool",
        "Pool",
        "List pools, show what one holds, or remove pools of your own: cluttergen pool show mine.",
    ),
    "inspect": Command(
        "inspect_",
        "Inspect",
        "Show what was measured about a pool's objects; draw each mesh beside its collision parts.",
    ),
    "list": Command("list_", "List", "List pools and their objects, supports and checkpoints."),
    "doctor": Command("doctor", "Doctor", "Show versions, devices, renderers and extras."),
}


def all_commands() -> Any:
    """The union of all commands as tyro takes it: what a shell's completion is made of."""
    from tyro.conf import subcommand

    return functools.reduce(
        or_, (Annotated[command.load(), subcommand(name)] for name, command in COMMANDS.items())
    )


def overview() -> str:
    """What `cluttergen --help` says."""
    lines = [f"  {name:<10}{command.about}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            "usage: cluttergen COMMAND [OPTIONS]",
            "",
            "Cluttered, physically stable, diverse tabletop scenes.",
            "",
            "commands:",
            *lines,
            "",
            "options:",
            "  -h, --help                          this text; after a command, its options",
            "  --version                           the version",
            "  --tyro-write-completion SHELL FILE  completion for bash, zsh, fish or tcsh (README.md)",
            "",
            "Example: cluttergen generate --pool dining --num-scenes 20 --out bank",
        ]
    )
