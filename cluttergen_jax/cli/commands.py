"""The commands by name, where none of them is imported: `cluttergen --help` has only this to read."""

from __future__ import annotations

import functools
from importlib import import_module
from operator import or_
from typing import Annotated, Any

COMMANDS = {
    "generate": "Generate verified cluttered scenes and save them as a bank.",
    "verify": "Check that saved scenes are stable, in plain MuJoCo. Exit status 1 if one is not.",
    "judge": "Judge anybody's scenes by one strict rule: MJCF, URDF, SDF or USD files, or arrays of starts.",
    "repair": "Make broken layouts stable with little motion: noisy poses, JSON of a language model.",
    "export": "Write scenes of a bank as a self-contained folder for another program.",
    "certify": "Add a stability certificate to each successful scene of a bank, a column for each measure.",
    "stats": "Show what a bank holds: successes, failures by reason, objects, attempts, duplicates, gaps.",
    "push": "Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.",
    "pull": "Fetch a bank, or policies, from the Hugging Face Hub (extra `hub`) and check every file of it.",
    "view": "Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.",
    "render": (
        "Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure."
    ),
    "dataset": "Make a dataset of views of banks: colour, depth, labels, masks, poses. Rerun to resume.",
    "train": "Train a placement policy with PPO. Rerun to resume.",
    "pretrain": "Pretrain a point encoder by classifying shapes. Rerun to resume.",
    "evaluate": "Compare methods on pools and supports.",
    "placer": "Stable placement from one camera's view: `placer data`, `placer train` and `placer eval`.",
    "robot": "A robot arm in simulation: `robot grasps`, `robot place` and `robot dataset`.",
    "rearrange": "Let a simulated robot arm rearrange the objects of scenes (extra `robot`).",
    "import": (
        "Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, SDF, MJCF, or `ycb`."
    ),
    "pool": (
        "List pools, show what one holds, remove your own, or change an object's pose: cluttergen pool list."
    ),
    "inspect": "Show what was measured about objects of a pool, or surfaces of a support; draw it.",
    "list": "List pools and their objects, supports, layouts, robots and checkpoints.",
    "doctor": "Show versions, devices, renderers and extras.",
}
"""What each command is for: the first line of its docstring."""
_MODULES = {
    "doctor": ("doctor",),
    "downstream": ("placer", "robot", "rearrange"),
    "import_": ("import",),
    "learning": ("train", "pretrain", "evaluate"),
    "pools": ("pool", "inspect", "list"),
}
"""Where commands are defined; the others are in `scenes`."""
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def load(name: str) -> Any:
    """The class of a command's options; importing it imports no JAX and no MuJoCo."""
    module = import_module(f"cluttergen_jax.cli.{_MODULE_OF.get(name, 'scenes')}")
    return getattr(module, f"run_{name}").options


def all_commands() -> Any:
    """The union of all commands as tyro takes it: what a shell's completion is made of."""
    from tyro.conf import subcommand

    return functools.reduce(or_, (Annotated[load(name), subcommand(name)] for name in COMMANDS))


def overview() -> str:
    """What `cluttergen --help` says."""
    lines = [f"  {name:<12}{about}" for name, about in COMMANDS.items()]
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
            "  --tyro-write-completion SHELL FILE  completion for bash, zsh, fish or tcsh (docs/start.md)",
            "",
            "Example: cluttergen generate --pool dining --num-scenes 20 --out bank",
        ]
    )
