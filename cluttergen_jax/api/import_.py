"""Imports: from files to pools of measured bodies, and to supports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.assets.config import (
    MAX_MASS,
    MAX_SIZE,
    MAX_TEXTURE,
    NUM_TRIALS,
    TIME_LIMIT,
    DecompositionConfig,
)
from cluttergen_jax.config import Axis, ByVolume, Collision, Tier, Up
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.spec import in_groups, renamed

if TYPE_CHECKING:
    from cluttergen_jax.assets.support import SupportAsset
    from cluttergen_jax.importing.run import ImportReport


@in_groups(
    what="pool set settings max_size max_mass take_all licence attribution",
    files="add force",
    machine="jobs time_limit progress cluster workers",
)
def import_pool(
    sources: Sequence[str | Path] | str | Path,
    pool: str,
    *,
    tier: Tier = "standard",
    scale: float = 1.0,
    up: Up = "auto",
    front: Axis = "auto",
    density: float = 500.0,
    mass: float | ByVolume | None = None,
    max_texture: int = MAX_TEXTURE,
    decomposition: DecompositionConfig | None = None,
    trials: int = NUM_TRIALS,
    jobs: int = 0,
    time_limit: float = TIME_LIMIT,
    friction: float | None = None,
    licence: str = "",
    attribution: str = "",
    settings: str | Path | None = None,
    set: str = "auto",
    collision: Collision = "auto",
    max_size: float = MAX_SIZE,
    max_mass: float = MAX_MASS,
    take_all: bool = False,
    add: bool = False,
    force: bool = False,
    progress: bool = True,
    cluster: str | None = None,
    workers: int = 0,
) -> ImportReport:
    """Makes a user pool of all objects that files and folders hold (`cluttergen import --pool`).

    It works in processes of its own: a script calls it below `if __name__ == "__main__":`. An interrupted
    import takes up where it stopped.

    Args:
      sources: files or folders; the word "ycb" stands for the 78 YCB objects (extra `ycb`).
      pool: the new pool's name.
      tier: "standard" (up to 32 convex parts), or "light" (one hull) for MJX in pure JAX.
      scale: factor from the files' unit to metres.
      up: the files' vertical axis; "file" is y for GLTF, what a DAE file says, and z for all others. "auto"
        begins with that, and turns an object as people put it if its file does not say which axis is up (OBJ,
        STL, PLY), or if it does not stand as the file says.
      front: the files' axis that becomes the objects' +x; "auto" is x, or -y where x is up.
      density: kg/m^3, where the mass is not known.
      mass: kilograms for every object, such as the paper's 0.1; or "volume", to take volume times density
        where files state a mass, too.
      max_texture: pixels a side that an image may have; larger ones are shrunk.
      decomposition: CoACD's parameters; the defaults of `DecompositionConfig` if not given.
      trials: placements by which solo stability is measured.
      jobs: worker processes; 0 takes one for each core.
      time_limit: seconds that one object may take; then it is left out by name, and the others are imported.
      friction: sliding coefficient of every object, instead of 0.5 wherever it touches something.
      licence: on which terms the objects may be passed on, where their source does not say.
      attribution: whom to name, where the licence asks for it.
      settings: a TOML or CSV file of settings per object, in place of the objects.toml in each folder.
      set: the published set that the folders are of, such as "robosuite": which files are its models, and
        what they do not say; "auto" for what the folders show, "none" for no such knowledge.
      collision: "keep" takes collision shapes that lie beside a mesh (mug_col.obj, collision/mug_0.obj) as
        its parts; "auto" cuts the mesh itself.
      max_size: metres; what has a side of as much is left out, as it does not fit the usual table.
      max_mass: kilograms; what is heavier is left out.
      take_all: take what is too large or too heavy, and scenery, robots and copies of objects, as well.
      add: add to the pool, which exists; objects of equal names are refused, or replaced with `force`.
      force: make everything again, and replace a pool, a support, or with `add` objects of that name.
      progress: show a progress bar; the line that tells of each object, and what it cost, is written anyway.
      cluster: where it is done: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In processes of its own if not given. All machines
        have to see the files under the same path.
      workers: worker processes on the cluster; 0 takes as many as it has room for.

    Returns:
      What was made (`pool`), skipped, left out (`left_out`), and what failed, and why: a file that is
      damaged fails alone; and what each object cost (`costs`).

    Raises:
      ConfigError, PoolError, AssetError, MissingExtraError: see `importing.run.import_sources`.
    """
    from cluttergen_jax.assets.body import BodyConfig
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.importing.readers import ReadOptions
    from cluttergen_jax.importing.run import ImportConfig, ObjectConfig, import_sources
    from cluttergen_jax.importing.scenery import Limits

    read = ReadOptions(
        scale=scale,
        up=up,
        front=front,
        density=density,
        mass=mass,
        friction=friction,
        licence=licence,
        attribution=attribution,
        max_texture=max_texture,
        collision=collision,
    )
    config = ObjectConfig(read, BodyConfig(tier, decomposition or DecompositionConfig()), trials)
    file = None if settings is None else Path(settings)
    place = cluster_of(cluster, workers)
    for name, value in (("max_size", max_size), ("max_mass", max_mass)):
        if not 0 < value < math.inf:
            raise ConfigError(
                f"{name} = {value!r}", "a finite number above zero", f"leaving {name} out"
            )
    limits = Limits(max_size, max_mass)
    how = ImportConfig(
        config, jobs, force, progress, add, file, place, time_limit, set, limits, take_all
    )
    return import_sources([sources] if isinstance(sources, str | Path) else sources, pool, how)


@renamed(path="support")
@in_groups(what="support name licence attribution", files="force")
def import_support(
    support: str | Path,
    name: str | None = None,
    *,
    scale: float = 1.0,
    up: Up = "auto",
    front: Axis = "auto",
    joint: Sequence[str] = (),
    max_texture: int = MAX_TEXTURE,
    licence: str = "",
    attribution: str = "",
    force: bool = False,
) -> SupportAsset:
    """Makes a support of the user's own of a table, a shelf or a board (`cluttergen import --support`).

    It is stood up by its shape, and that is said, where its file's pose has no surface to put things on or
    lies on its top, or its format states no axis; `up="file"` keeps the file's. Several bodies of one file
    are one piece, but for those that move freely.

    All its surfaces are found: connected, at most 10 degrees from level, 5 cm wide or wider, 50 cm^2 or
    larger, with 5 cm of air above that is reached from outside, and that the convex parts leave free. The
    largest level one under the open sky is called top and comes first; the others are shelf_1, shelf_2 ...
    from the highest to the lowest. With more than one surface all boards, walls and legs collide; of a table
    with its top alone, the top and what rises above it.

    The arguments that are not explained here are those of `import_pool`.

    Args:
      support: instead of sources and a pool, the file of one piece of furniture with a level or gently
        sloping surface: a mesh, URDF, SDF or MJCF, or a folder that holds one. FILE#BODY takes one body,
        link, model or node of MJCF, URDF, SDF or glTF, with all that hangs on it.
      name: the new support's name; the file's or the body's own if not given, with my_ before it where a
        support of that name comes with the package.
      joint: where joints of a URDF or MJCF file are to be, NAME=VALUE each, in metres, or degrees for those
        that turn, such as drawer_1=0.2; the others stay at their lower limit, or where the file has them.
        Limits are met to within the rounding of the file's numbers. If none is given, doors and drawers that
        hide surfaces are opened, and scenes close them (`doors`).

    Returns:
      The support; its name is what `support` of `make_sampler` takes. `surfaces` has what was found.

    Raises:
      AssetError: the file cannot be read, a folder holds several, or it has no surface to speak of.
      ConfigError: an option is out of range, or there is no such body.
      PoolError: the name is not one, is taken by an embedded support, or by another support and `force` is
        not set.
    """
    from cluttergen_jax.importing.readers import ReadOptions
    from cluttergen_jax.importing.supports import write_table

    options = ReadOptions(
        scale=scale,
        up=up,
        front=front,
        max_texture=max_texture,
        licence=licence,
        attribution=attribution,
    )
    return write_table(support, name, options, force, _joints_of(joint))


def _joints_of(texts: Sequence[str]) -> dict[str, float]:
    form = "NAME=VALUE, metres or degrees"
    if isinstance(texts, str):
        raise ConfigError(f"joint = {texts!r}", "a sequence of texts", f"joint=[{texts!r}]")
    found = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError as error:
            raise ConfigError(f"joint {text!r}", form, "drawer_1=0.2") from error
        if not name or not math.isfinite(found[name]):
            raise ConfigError(f"joint {text!r}", form, "drawer_1=0.2")
    return found
