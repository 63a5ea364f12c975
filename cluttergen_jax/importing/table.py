"""A user's own table: from a file to a support that can be named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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


def write_table(path: str | Path, name: str | None, options: ReadOptions, force: bool) -> SupportAsset:
    """The support of a table's file, among the user's own; see `cluttergen_jax.import_support`."""
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
