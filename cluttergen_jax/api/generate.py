"""A bank of scenes from names and numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.config import check_range
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.spec import SceneOptions, SceneSpec, spec_of, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.generation.generate import GeneratedBank

MAX_SCENES = 2_000_000_000
_MOST = 2**32 - 1


@with_kept_programs
@takes_spec()
def generate(
    out: str | Path = "out",
    spec: SceneSpec | str | Path | None = None,
    *,
    layout: str | Path | None = None,
    num_scenes: int = 20,
    seed: int = 0,
    render: bool = True,
    max_files: int = 1000,
    overwrite: bool = False,
    allow_other_bits: bool = False,
    cluster: str | None = None,
    workers: int = 0,
    **options: Unpack[SceneOptions],
) -> GeneratedBank:
    """Samples scenes and saves them as a bank, failures included; `cluttergen generate`.

    The same call continues an interrupted one, and mends what is damaged. Scene i of it is what
    `make_sampler` makes of the key `jax.random.fold_in(jax.random.key(seed), i)`. The arguments that are not
    explained here are those of `SceneSpec`.

    Args:
      out: the bank's folder, or a URL such as s3://bucket/name; an interrupted bank is continued.
      spec: what is asked for, or a pool's name.
      layout: what shall stand where: a YAML file, or a name of `cluttergen list`, such as breakfast_for_two
        (`read_layout`); other options that are not at their defaults go before what it says.
      num_scenes: scenes to make, failures counted.
      seed: the same seed makes the same scenes, 0 to 4294967295.
      render: draw a picture of each scene that gets a file.
      max_files: the first so many scenes get an MJCF file each (and a picture) if they succeed.
      overwrite: begin anew if the folder holds another bank.
      allow_other_bits: continue a bank even if another processor, other flags of XLA or another jaxlib made
        its scenes, so that the same seed here makes others; its record tells of both.
      cluster: where scenes are made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given.
      workers: worker processes on the cluster, of `num_threads` cores each, one if that is 0; 0 takes as many
        as it has room for. Equal machines make the same bank, however many there are.
      options: fields of `SceneSpec`, in place of those of `spec`.

    Returns:
      The bank; printed, it tells how well it went.

    Raises:
      ConfigError, PoolError: as `make_sampler`.
      BankError: the folder holds something else, cannot be written, or is being written by another process;
        or the scene to start from cannot be read.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.generation.generate import write_bank
    from cluttergen_jax.generation.layouts import read_layout

    if layout is not None:
        if spec is not None:
            raise ConfigError(f"`layout` {str(layout)!r} beside `spec`", "one or the other")
        spec = read_layout(layout)
    asked = spec_of(generate, spec, options)
    check_range("num_scenes", num_scenes, 1, MAX_SCENES, 20)
    check_range("seed", seed, 0, _MOST, 0)
    if max_files < 0:
        raise ConfigError(f"max_files = {max_files}", "0 or more", "max_files=0 for none")
    return write_bank(
        out,
        asked,
        seed,
        num_scenes,
        render,
        max_files,
        overwrite,
        cluster_of(cluster, workers),
        allow_other_bits,
    )
