"""Banks given and taken: exported to other programs, cut, pushed to a hub and pulled from one."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cluttergen_jax.api.text import scene_numbers
from cluttergen_jax.config import CameraName, ExportFormat
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.spec import renamed

if TYPE_CHECKING:
    from cluttergen_jax.scene import Bank, Scene
    from cluttergen_jax.scene.export import Format

_MANY = 10
_OF_POLICIES = ("*/record.json", "*/weights.npz", "*/README.md", "*/curve.png")


def export(
    source: str | Path | Bank | Scene | Iterable[Scene],
    out: str | Path,
    format: ExportFormat | str | Format = "mjcf",
    *,
    scenes: Sequence[int] | str | None = None,
    cameras: Sequence[CameraName] = (),
    old_mujoco: bool = False,
    joints: bool = False,
    grasps: str | Path | None = None,
    look: str | Path = "plain",
    robot: str | Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Writes scenes as a self-contained folder for another program (`cluttergen export`).

    Args:
      source: a bank; or one scene of it: BANK:INDEX, or its file BANK/scenes/000003.xml. In Python also a
        `Bank`, a `Scene`, or several that share support, contact parameters and time step.
      out: the folder to make.
      format: "mjcf" (MuJoCo), "urdf" (PyBullet), "sdf" (Drake, Gazebo), "usd" (Isaac, Omniverse), "glb" (any
        viewer), "maniskill", "robosuite", "libero", "robocasa", "molmospaces", "moveit" or "rerun".
        "mjlab", "playground" (MuJoCo Playground) and "lerobot"
        (EnvHub) are the whole bank with a script that uses it there. FILE.py:NAME or MODULE:NAME is one of
        your own, a `Format` that this variable holds; in Python also the `Format` itself.
      scenes: numbers such as 0,3,7 or 0-9; all successful ones if not given. In Python also a list.
      cameras: cameras around the support, to be added to every scene: "overhead", "front", "side", "wrist".
      old_mujoco: with "mjcf", files that MuJoCo before 3.2.3 reads, too, from 2.3.7 on.
      joints: with "mjcf", drawers and doors of the support can move.
      grasps: grasps to write beside objects, with "molmospaces": a file of `cluttergen robot grasps --out`.
      look: draws a support that has no surfaces of its own as a table in wood, marble and so on: a name, or
        a YAML file (docs/guide/pictures.md). What collides stays.
      robot: whose environment goes with the bank, with "lerobot": a name of `cluttergen list`, or the YAML
        file of one; panda if not given.
      overwrite: replace an earlier export.

    Returns:
      The folder.

    Raises:
      BankError: there is no such bank or scene, or none that succeeds; or another export is being written to
        `out`.
      ConfigError: there is no such format or camera, two answers to one question, grasps of other objects,
        or `source` is neither a bank nor scenes.
      MissingExtraError: the format needs an extra that is not installed; `lerobot` needs `robot` and `gym`.
    """
    from cluttergen_jax.progress import track
    from cluttergen_jax.scene.bank import (
        REFERENCES,
        Bank,
        check_is_here,
        good_indices,
        local_paths,
        num_good,
        parse_reference,
        read_bank,
        read_scenes,
    )
    from cluttergen_jax.scene.export import BANK_FORMATS, export_bank, export_scenes
    from cluttergen_jax.scene.export.formats import find_format

    takes_bank = isinstance(format, str) and format in BANK_FORMATS
    kind = None if takes_bank else find_format(format, old_mujoco=old_mujoco, joints=joints)
    has_robot = takes_bank and BANK_FORMATS[str(format)].has_robot
    if robot is not None and not has_robot:
        name = format if isinstance(format, str) else format.name
        raise ConfigError(
            f"`robot` with the format {name!r}, which has none", "lerobot", "format='lerobot'"
        )
    if kind is not None and cameras and not kind.takes_cameras:
        note = f"note: cameras stand in scenes/*.json alone: what {kind.name} reads has none"
        print(note, file=sys.stderr)
    if isinstance(source, Bank):
        source = source.path
    if not isinstance(source, str | Path):
        if scenes is not None:
            raise ConfigError("`scenes` beside scenes themselves", "one of the two")
        if kind is None:
            given = f"scenes with the format {format!r}, which takes a whole bank"
            raise ConfigError(given, "a bank", "`cluttergen_jax.generate`")
        return export_scenes(
            _furnish_scenes(_scenes_of(source), look),
            out,
            kind,
            overwrite=overwrite,
            cameras=tuple(cameras),
            grasps=grasps,
        )
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
    if kind is None:
        options: dict[str, Any] = {
            "scenes": numbers,
            "cameras": tuple(cameras),
            "grasps": grasps,
            "old_mujoco": old_mujoco,
            "joints": joints,
            "look": "" if str(look) == "plain" else look,
        }
        asked = [f"`{name}`" for name, value in options.items() if value]
        if asked:
            text = f"{', '.join(asked)} with the format {format!r}, which takes the whole bank"
            if asked == ["`scenes`"]:
                hint = "`cluttergen cut`, which makes that bank, then this export of it"
                raise ConfigError(text, "a bank of just these scenes", hint)
            raise ConfigError(text, "none of these options", "leaving them out")
        check_is_here(bank.path)
        indices = good_indices(bank)
        for local in local_paths(bank):
            print(f"note: the bank's record names a path of this machine: {local}", file=sys.stderr)
        objects = [bank.object(name) for name in sorted(bank.assets["objects"])]
        return export_bank(
            bank.path, bank.support, objects, indices, out, str(format), overwrite, robot or "panda"
        )
    total = num_good(bank) if numbers is None else len(numbers)
    read = read_scenes(bank, numbers)
    read = _furnish_scenes(read, look)
    shown = read if total <= _MANY else track(read, "exporting", total, "scene")
    return export_scenes(
        shown, out, kind, overwrite=overwrite, cameras=tuple(cameras), grasps=grasps
    )


def cut(
    bank: str | Path | Bank,
    out: str | Path,
    scenes: Sequence[int] | str,
    *,
    overwrite: bool = False,
) -> Bank:
    """Makes a bank of some scenes of another, numbered anew from 0 in the order given (`cluttergen cut`).

    Rows, certificates, models and pictures are those of the other bank, failures included; objects that no
    scene has are kept where all scenes were drawn from the same. The record says which scenes of which bank
    they are, so attempts can be made again, but `generate` does not continue it. A cut that was interrupted
    goes on.

    Args:
      bank: a bank in a folder; it is only read. In Python also a `Bank`.
      out: a folder that does not exist yet, or that of the same cut.
      scenes: numbers such as 0-99 or 7,3; "all" for all that are there. In Python also a list.
      overwrite: begin anew if the folder holds another bank.

    Raises:
      BankError: there is no such bank or scene, a file of it was changed, or `out` holds something else or is
        being written by another process.
      ConfigError: no scenes, one twice, or `out` is the bank itself.
    """
    from cluttergen_jax.scene.bank import Bank, cut_bank, read_bank

    source = bank if isinstance(bank, Bank) else read_bank(bank)
    return cut_bank(source, scene_numbers(scenes), out, overwrite)


def _furnish_scenes(scenes: Iterable[Scene], look: str | Path) -> Iterator[Scene]:
    """The scenes with their support as a look draws it; ConfigError: there is no such look."""
    from cluttergen_jax.rendering.furnish import furnish
    from cluttergen_jax.rendering.look import find_look

    drawn = find_look(look)
    # Scenes of one file share their support.
    furnished = lru_cache(None)(lambda support: furnish(support, drawn))
    return (replace(scene, support=furnished(scene.support)) for scene in scenes)


def _scenes_of(source: Any) -> list[Scene]:
    """The scenes that were given, one or several (ConfigError)."""
    from cluttergen_jax.scene import Scene

    given = [source] if isinstance(source, Scene) or not isinstance(source, Iterable) else source
    scenes = list(given)
    wrong = [each for each in scenes if not isinstance(each, Scene)]
    if wrong or hasattr(source, "is_success"):
        what = type(source if hasattr(source, "is_success") else wrong[0]).__name__
        raise ConfigError(
            f"`source` of {what}",
            "a bank, a `Scene`, or several",
            "`sampler.scene(sampled)`, which makes a `Scene` of what a sampler drew",
        )
    return scenes


@renamed(is_private="private")
def push_bank(
    path: str | Path,
    name: str,
    *,
    hub: str | None = None,
    private: bool = False,
    allow_outside: bool = False,
) -> str:
    """Publishes a bank as a data set, with its card; returns where it is.

    What is there under that name is replaced at once, if it is a bank: a hub keeps its earlier revisions.

    Args:
      path: a whole bank's folder; nobody may be writing it.
      name: OWNER/NAME.
      hub: another server's address, https://..., or a folder; the variable CLUTTERGEN_HUB says the same. The
        Hugging Face Hub if not given.
      private: a new data set can be seen by its owner alone.
      allow_outside: publish also what was made of files from outside the folders that were imported.

    Raises:
      BankError: the bank is not whole, holds what was made of files from outside the folders that were
        imported, the name is none or that of something else, or the hub refuses or cannot
        be reached.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.scene.bank import push

    return push(path, name, hub, private, allow_outside)


def pull_bank(
    name: str,
    out: str | Path | None = None,
    *,
    hub: str | None = None,
    revision: str | None = None,
    overwrite: bool = False,
    allow_unchecked: bool = False,
) -> Path:
    """Fetches a bank; returns its folder, which is there whole or not at all.

    It is fetched beside its place; its names, rows, assets and the digests of all files are checked, each
    scene's file is held against its row, and then it is moved there. An interrupted pull resumes where it
    stopped.

    Args:
      name: OWNER/NAME.
      out: a folder that does not exist yet. If not given, the command takes NAME, and a function the folder
        in which `load_bank` keeps it.
      hub: another server's address, https://..., or a folder; the variable CLUTTERGEN_HUB says the same. The
        Hugging Face Hub if not given.
      revision: a branch, tag or commit; the latest if not given.
      overwrite: replace a bank that is there.
      allow_unchecked: take a bank that has no digests of its files or rows: those of older versions.

    Raises:
      BankError: there is no such bank, it is damaged or has no digests, `out` exists or is being written by
        another process, or the hub cannot be reached.
      UnsafePathError: it names paths outside of its folder.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.scene.bank import pull

    return pull(name, out, hub, revision, overwrite, allow_unchecked)


def pull_policies(
    name: str, *, hub: str | None = None, revision: str | None = None, overwrite: bool = False
) -> list[str]:
    """Fetches checkpoints of policies, which methods find by name from then on (`cluttergen pull`).

    Weights of ablations do not come with the package: `scenes` of a checkout of the repository is a hub of
    its own, as in `cluttergen pull scenes/ablations --hub CHECKOUT`.

    Args:
      name: OWNER/NAME of a data set with a folder for each checkpoint, POOL-VARIANT.
      hub: as in `pull_bank`.
      revision: a branch, tag or commit; the latest if not given.
      overwrite: replace checkpoints of these names that were pulled before.

    Returns:
      The names, POOL-VARIANT.

    Raises:
      BankError: there is no such data set, it holds no checkpoint, one is there already, another process
        pulls some, or the hub cannot be reached.
      PoolError: a checkpoint is damaged.
      UnsafePathError: it names paths outside of its folder.
      MissingExtraError: the extra `hub` is not installed.
    """
    from cluttergen_jax.files import inside, scratch_folder, swap_in, writing
    from cluttergen_jax.kept_folder import hold_folder
    from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
    from cluttergen_jax.learning.policies.embedded import pulled_root
    from cluttergen_jax.learning.ppo.checkpoint import check_weights
    from cluttergen_jax.scene.bank import hub_of

    place = hub_of(hub)
    root = pulled_root()
    commit, files = place.listing(name, revision)
    found = sorted(
        {
            each.split("/")[0]
            for each in files
            if each.count("/") == 1 and each.endswith("/record.json")
        }
    )
    if not found:
        raise BankError(
            f"{name} holds no checkpoints", "a folder POOL-VARIANT with record.json for each"
        )
    with hold_folder(root):
        if there := [each for each in found if inside(root, each).exists() and not overwrite]:
            raise BankError(
                f"{root / there[0]} exists",
                "names that do not exist yet",
                "`overwrite` to replace them",
            )
        with writing(root), scratch_folder(root / "fetched") as scratch:
            place.fetch(name, commit, scratch, _OF_POLICIES)
            for each in found:
                check_weights(read_checkpoint(inside(scratch, each)).path)
            for each in found:
                swap_in(scratch / each, root / each)
        return found


def holds_policies(name: str, hub: str | None = None, revision: str | None = None) -> bool:
    """Whether a data set on a hub holds checkpoints and no bank; the errors are those of `pull_bank`."""
    from cluttergen_jax.scene.bank import hub_of

    files = hub_of(hub).listing(name, revision)[1]
    return "bank.json" not in files and any(each.endswith("/record.json") for each in files)
