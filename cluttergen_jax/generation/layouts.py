"""Layouts: what shall stand where, in a few lines of YAML that people and language models can write."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from cluttergen_jax.assets.pool import embedded_root, find_pool
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.files import is_regular_file
from cluttergen_jax.placement.relations import conditions_of, parse_relations
from cluttergen_jax.schema import SchemaError, convert, parse_yaml, read_written
from cluttergen_jax.spec import SceneSpec

_HINT = "a file such as those of `cluttergen list`"


class _File(msgspec.Struct, forbid_unknown_fields=True):
    """A layout as its file has it.

    Attributes:
      title: what people call it.
      objects: names and the condition of the objects that each may stand for (`SceneSpec.roles`).
      relations: what must hold of them (`SceneSpec.relations`).
      pool, support, region: see `SceneSpec`.
      others: objects of the pool that stand anywhere besides.
    """

    objects: dict[str, str]
    title: str = ""
    relations: list[str] = []
    pool: str = str(SceneSpec.pool)
    support: str = str(SceneSpec.support)
    region: str | None = None
    others: int = 0


def list_layouts() -> dict[str, Path]:
    """The layouts that come with the package: names and files."""
    return {path.stem: path for path in sorted((embedded_root() / "layouts").glob("*.yaml"))}


def read_layout(layout: str | Path) -> SceneSpec:
    """The request that a layout is: a file, or the name of one that comes with the package.

        cluttergen_jax.generate("out", cluttergen_jax.read_layout("breakfast_for_two"))

    A file has `objects`, names of your own and which objects of the pool each may stand for; `relations`
    between them and other objects of the pool; and, if wanted, `title`, `pool`, `support`, `region` and
    `others`, the number of further objects of the pool. Where the pool has too few objects for the names,
    they come more than once.

    Raises:
      ConfigError: there is no such layout, it is no YAML, or something in it is not understood.
    """
    given = _read(layout)
    relations = parse_relations(tuple(given.relations))
    conditions = conditions_of(tuple(given.objects.items()), relations)
    _check_names([name for name in conditions if name not in given.objects], given, layout)
    if given.others < 0:
        raise ConfigError(f"others = {given.others} in layout {str(layout)!r}", "0 or more")
    # Only what may be placed is compiled into the world.
    objects = () if given.others else tuple(dict.fromkeys(conditions.values()))
    return SceneSpec(
        pool=given.pool,
        objects=objects,
        num_objects=len(conditions) + given.others,
        repeat=True,
        support=given.support,
        region=given.region,
        relations=tuple(given.relations),
        roles=given.objects,
    )


def _check_names(names: Sequence[str], given: _File, layout: str | Path) -> None:
    """Refuses names in relations that are neither the layout's own nor objects of its pool (ConfigError)."""
    if not names:
        return
    pool = find_pool(given.pool).names
    for name in names:
        if name not in ("any", *pool):
            raise ConfigError(
                f"{name!r} in a relation of layout {str(layout)!r}",
                f"{', '.join(given.objects)}, or an object of pool {given.pool!r}: {', '.join(pool)}",
                meant=closest(name, [*given.objects, *pool]),
            )


def _read(layout: str | Path) -> _File:
    known = list_layouts()
    path = known.get(str(layout), Path(layout))
    if not is_regular_file(path):
        meant = closest(str(layout), tuple(known))
        raise ConfigError(
            f"layout {str(layout)!r}", f"a YAML file, or {', '.join(known)}", _HINT, meant
        )
    try:
        content = parse_yaml(read_written(path))
    except (SchemaError, OSError) as error:
        raise ConfigError(f"layout {path}: {error}", "YAML", _HINT) from error
    try:
        return convert(content, _File)
    except SchemaError as error:
        fields = ", ".join(_File.__struct_fields__)
        raise ConfigError(f"layout {path}: {error}", f"a mapping with {fields}", _HINT) from error
