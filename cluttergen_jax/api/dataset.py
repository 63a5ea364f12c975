"""Datasets of views from banks of scenes (`cluttergen dataset`)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from cluttergen_jax.config import DatasetForm, Variation, check_range
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.rendering.config import QUALITIES, Quality

if TYPE_CHECKING:
    from cluttergen_jax.views.dataset import ViewDataset

_SPLITS = ("train", "val", "test")


@with_own_settings
def make_dataset(
    banks: Sequence[str | Path] | str | Path,
    out: str | Path = "dataset",
    *,
    cameras: Sequence[str | Path] = ("free:4",),
    size: tuple[int, int] | str | None = None,
    form: DatasetForm = "parquet",
    splits: str = "train",
    num_scenes: int | None = None,
    vary: Sequence[Variation] = (),
    quality: Quality = "draft",
    colour: bool = True,
    seed: int = 0,
    cluster: str | None = None,
    workers: int = 0,
) -> ViewDataset:
    """Makes what cameras see of every scene that stands (`cluttergen dataset`).

    A view has colour, depth, labels, each object's whole silhouette and visible share, boxes, poses, and the
    camera. The same call takes up an interrupted one.

    Args:
      banks: a bank's folder, or several.
      out: the folder.
      cameras: "free", "overhead" or "side", "free:4" for four that are drawn for each scene, or JSON files
        with cameras of your own, fixed or drawn from ranges (docs/guide/datasets.md).
      size: of all pictures, WIDTHxHEIGHT in pixels; 640x480, or a file's own, if not given. In Python also a
        pair.
      form: "parquet"; "webdataset", tar files; or "bop", a folder for each scene.
      splits: "train", or shares of each bank's scenes such as "train=0.8, val=0.1, test=0.1", to the nearest
        scene. `seed` draws which; scenes of a dataset that grows stay where they are.
      num_scenes: the first so many of each bank; all if not given.
      vary: what is drawn anew for each view: "texture" of the table, from other ones for each split; "light";
        "colour" of objects and floor.
      quality: "draft" has sharp shadows; "fine" soft ones, for some five times the time.
      colour: draw colours, which needs OpenGL; all else needs none.
      seed: of cameras, splits and what varies, 0 to 4294967295.
      cluster: where it is made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`); none with "bop". All machines have to see banks and
        `out` under the same path. In this process if not given.
      workers: worker processes on the cluster; 0 takes as many as it has room for.

    Returns:
      The dataset; printed, it tells what there is.

    Raises:
      ConfigError: a setting is out of range, or there is no such camera.
      BankError: there is no bank, none of its scenes stands, or the folder holds something else.
      RendererError: colours are wanted, and nothing here can draw.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.api.text import parse_size
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.rendering.gl import find_backend
    from cluttergen_jax.rendering.renderer import check_size
    from cluttergen_jax.scene.bank.remote import bank_folder
    from cluttergen_jax.sensing import parse_cameras
    from cluttergen_jax.views.dataset import ViewConfig, make

    cameras = (cameras,) if isinstance(cameras, str | Path) else cameras
    if isinstance(vary, str):
        raise ConfigError(f"vary = {vary!r}", "a sequence of words", f"vary=({vary!r},)")
    check_folder(out)
    check_range("seed", seed, 0, 2**32 - 1, 0)
    if num_scenes is not None:
        check_range("num_scenes", num_scenes, 1, 10_000_000, 100)
    for name, given, allowed in (
        ("form", form, get_args(DatasetForm)),
        ("quality", quality, tuple(QUALITIES)),
        *(("vary", each, get_args(Variation)) for each in vary),
    ):
        if given not in allowed:
            raise ConfigError(f"{name} = {given!r}", ", ".join(allowed), f"{name}={allowed[0]!r}")
    pixels = parse_size(size) if isinstance(size, str) else size
    seen_by = parse_cameras(cameras, pixels)
    for each in seen_by:
        check_size(*each.size, 1)
    if colour:
        find_backend()
    elif vary:
        raise ConfigError(f"vary = {tuple(vary)} without colours", "colours", "colour=True")
    if form == "bop" and cluster is not None:
        raise ConfigError(
            f"cluster = {cluster!r} with form 'bop'",
            "one of the two",
            "form='parquet' or 'webdataset'",
        )
    chosen = [banks] if isinstance(banks, str | Path) else list(banks)
    if not chosen:
        raise ConfigError("no bank", "one or more")
    folders = [bank_folder(each) for each in chosen]
    if len({each.resolve().name for each in folders}) < len(chosen):
        told = f"banks = {[str(each) for each in chosen]}"
        raise ConfigError(
            told, "each bank once, and no two folders of one name", "another name of a folder"
        )
    place = cluster_of(cluster, workers)
    config = ViewConfig(seen_by, seed, tuple(vary), quality, colour)
    return make(folders, parse_splits(splits), num_scenes, config, Path(out), form, place)


def parse_splits(text: str) -> dict[str, float]:
    """Shares by split, of a text such as "train=0.8, val=0.2" or "test".

    Raises:
      ConfigError: a split is none, comes twice, or the shares do not make 1.
    """
    shares: dict[str, float] = {}
    terms = [term.strip() for term in text.split(",")]
    for term in terms:
        match = re.fullmatch(r"(\w+)(?:\s*=\s*(0|1|0?\.\d+|1\.0*))?", term)
        is_bare = match is not None and match[2] is None and len(terms) > 1
        if match is None or match[1] not in _SPLITS or match[1] in shares or is_bare:
            raise ConfigError(
                f"splits = {text!r}",
                "one of train, val and test, or shares of them",
                "'train=0.9, test=0.1'",
            )
        shares[match[1]] = 1.0 if match[2] is None else float(match[2])
    if abs(sum(shares.values()) - 1) > 1e-6:
        raise ConfigError(
            f"splits = {text!r}, {sum(shares.values()):g} in all", "shares that make 1"
        )
    return shares
