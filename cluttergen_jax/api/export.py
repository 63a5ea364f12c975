"""Scenes of a bank as a folder that other programs open."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from cluttergen_jax.api.text import scene_numbers
from cluttergen_jax.config import CameraName, ExportFormat
from cluttergen_jax.errors import BankError, ConfigError

_MANY = 10


def export(
    source: str | Path,
    out: str | Path,
    format: ExportFormat = "mjcf",
    *,
    scenes: Sequence[int] | str | None = None,
    cameras: Sequence[CameraName] = (),
    grasps: str | Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Writes scenes of a bank as a self-contained folder for another program (`cluttergen export`).

    `cluttergen_jax.scene.export.export_scenes` does the same for scenes of a sampler.

    Args:
      source: a bank; or one scene of it: BANK:INDEX, or its file BANK/scenes/000003.xml.
      out: the folder to make.
      format: "mjcf" (MuJoCo), "mjcf-old" (MuJoCo before 3.2.3), "mjcf-joints" (drawers and
        doors of the support can move), "urdf" (PyBullet), "sdf" (Drake, Gazebo),
        "usd" (Isaac, Omniverse), "glb" (any viewer), "maniskill", "robosuite", "libero", "robocasa",
        "molmospaces" or "arena" (Isaac Lab-Arena). "mjlab", "playground" (MuJoCo Playground) and "lerobot"
        (EnvHub) are the whole bank with a script that uses it there.
      scenes: numbers such as 0,3,7 or 0-9; all successful ones if not given. In Python also a list.
      cameras: cameras around the support, to be added to every scene: "overhead", "front", "side", "wrist".
      grasps: grasps to write beside objects, with "molmospaces": a file of `cluttergen robot grasps --out`.
      overwrite: replace an earlier export.

    Returns:
      The folder.

    Raises:
      BankError: there is no such bank or scene, or none that succeeds; or another export is being written to
        `out`.
      ConfigError: there is no such format or camera, two answers to one question, or grasps of other objects.
      MissingExtraError: the format needs an extra that is not installed.
    """
    from cluttergen_jax.progress import track
    from cluttergen_jax.scene.bank import read_bank
    from cluttergen_jax.scene.bank.hub import local_paths
    from cluttergen_jax.scene.bank.reference import REFERENCES, parse_reference
    from cluttergen_jax.scene.bank.remote import check_is_here
    from cluttergen_jax.scene.bank.scene import good_indices, read_scenes, select_rows
    from cluttergen_jax.scene.export import BANK_FORMATS, export_bank, export_scenes
    from cluttergen_jax.scene.export.formats import find_format

    numbers = scene_numbers(scenes)
    named = parse_reference(str(source))
    if named is None:
        raise BankError(f"{source} is no scene of a bank", REFERENCES)
    path, own = named
    if own is not None:
        if numbers is not None:
            raise ConfigError(f"`scenes` beside the single scene {source}", "one of the two")
        numbers = [own]
    bank = read_bank(path)
    if format in BANK_FORMATS:
        options = {"scenes": numbers, "cameras": tuple(cameras), "grasps": grasps}
        if given := ", ".join(f"`{name}`" for name, value in options.items() if value):
            text = f"{given} with the format {format!r}, which takes the whole bank"
            raise ConfigError(text, "a bank of just these scenes", "`cluttergen generate`")
        check_is_here(bank.path)
        indices = good_indices(bank)
        for text in local_paths(bank):
            print(f"note: the bank's record names a path of this machine: {text}", file=sys.stderr)
        objects = [bank.object(name) for name in sorted(bank.assets["objects"])]
        return export_bank(bank.path, bank.support, objects, indices, out, format, overwrite)
    if cameras and not find_format(format).takes_cameras:
        note = f"note: cameras stand in scenes/*.json alone: what {format} reads has none"
        print(note, file=sys.stderr)
    total = len(good_indices(bank) if numbers is None else select_rows(bank, numbers))
    read = read_scenes(bank, numbers)
    shown = read if total <= _MANY else track(read, "exporting", total, "scene")
    return export_scenes(
        shown, out, format, overwrite=overwrite, cameras=tuple(cameras), grasps=grasps
    )
