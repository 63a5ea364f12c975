"""A user's own table: from a file to a support that can be named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import (
    embedded_supports,
    is_support_name,
    read_support,
    support_hash,
    user_supports,
    write_support,
)
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.importing.readers import ReadOptions, find_sources, read_shape
from cluttergen_jax.importing.support_import import support_from_mesh


def import_support(
    path: str | Path,
    name: str | None = None,
    *,
    scale: float = 1.0,
    up: str = "auto",
    front: str = "auto",
    max_texture: int = MAX_TEXTURE,
    licence: str = "",
    attribution: str = "",
    force: bool = False,
) -> SupportAsset:
    """Makes a support of the user's own of one table with a level top (`cluttergen import --support`).

    Args:
      path: a mesh, URDF or MJCF file, or a folder that holds one; 2 m across at most.
      name: what to call it; the file's own name if not given.
      scale, up, front, max_texture, licence, attribution: as in `import_pool`.
      force: replace a support of that name.

    Returns:
      The support; its name is what `support` of `make_sampler` takes.

    Raises:
      AssetError: the file cannot be read, holds several objects, or has no level top to speak of.
      ConfigError: an option is out of range.
      PoolError: the name is not one, is taken by an embedded support, or by another support and `force` is
        not set.
    """
    options = ReadOptions(
        scale=scale,
        up=up,
        front=front,
        max_texture=max_texture,
        licence=licence,
        attribution=attribution,
    )
    sources = find_sources(path)
    if len(sources) > 1:
        names = ", ".join(source.name for source in sources[:5])
        raise AssetError(
            f"{path} holds {len(sources)} objects ({names})", "one table", "the table's own file"
        )
    name = sources[0].name if name is None else name
    if not is_support_name(name) or name in embedded_supports():
        raise PoolError(
            f"a support called {name!r}",
            "names of a-z, 0-9, '_' and '-' that are neither embedded nor a cuboid's: not "
            f"{', '.join(embedded_supports())}, table-WxD",
            "name='my_table'",
        )
    support = replace(support_from_mesh(read_shape(sources[0], options)), name=name)
    folder = user_supports() / name
    if folder.exists() and not force:
        if _is_same(folder, support):
            return support
        raise PoolError(f"support {name!r} exists and is another", "a new `name`", "`force` to replace it")
    write_support(folder, support, overwrite=force)
    return support


def _is_same(folder: Path, support: SupportAsset) -> bool:
    try:
        return support_hash(read_support(folder)) == support_hash(support)
    except ClutterGenError:
        return False
