"""A user's own table: from a file to a support that can be named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cluttergen_jax.assets.readers import ReadOptions, find_sources, read_shape
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import (
    embedded_supports,
    is_support_name,
    read_support,
    support_hash,
    user_supports,
    write_support,
)
from cluttergen_jax.assets.support_import import support_from_mesh
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError


def import_support(
    path: str | Path, name: str | None = None, options: ReadOptions | None = None, force: bool = False
) -> tuple[Path, SupportAsset]:
    """Makes a support of the user's own of one table: a mesh, URDF or MJCF file, or a folder that holds one.

    Args:
      name: what to call it; the file's own name if not given.
      force: replace a support of that name.

    Returns:
      Its folder, and the support.

    Raises:
      AssetError: the file cannot be read, holds several objects, or has no level top to speak of.
      PoolError: the name is not one, is taken by an embedded support, or by another support and `force` is
        not set.
    """
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
            return folder, support
        raise PoolError(f"support {name!r} exists and is another", "a new `name`", "`force` to replace it")
    return write_support(folder, support, overwrite=force), support


def _is_same(folder: Path, support: SupportAsset) -> bool:
    try:
        return support_hash(read_support(folder)) == support_hash(support)
    except ClutterGenError:
        return False
