"""`cluttergen import`: from meshes, URDF, MJCF or YCB to a pool of measured bodies, or to a support."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from cluttergen_jax.assets.config import MAX_TEXTURE, DecompositionConfig
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.parse import keywords, refuse_given
from cluttergen_jax.errors import ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.importing.run import ImportReport

Axis = Literal["auto", "x", "y", "z", "-x", "-y", "-z"]
_OF_OBJECTS = ("mass", "density", "friction", "settings", "add", "tier", "trials")


@dataclass(frozen=True)
class Import:
    """Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, MJCF, folders, or `ycb`.

    Example: `cluttergen import my_meshes/ --pool mine --scale 0.001`

    Attributes:
      sources: files or folders; the word ycb stands for the 78 YCB objects (extra `ycb`).
      pool: the new pool's name.
      support: instead of sources and a pool, the file of one table with a level top, 2 m across at most.
      name: the new support's name; the file's own if not given.
      tier: standard (up to 32 convex parts), or light (one hull) for MJX in pure JAX.
      scale: factor from the files' unit to metres.
      up: the files' vertical axis; auto is y for GLTF, what a DAE file says, and z for all others.
      front: the files' axis that becomes the objects' +x; auto is x, or -y where x is up.
      density: kg/m^3, where the mass is not known.
      mass: kilograms for every object, such as the paper's 0.1.
      max_texture: pixels a side that an image may have; larger ones are shrunk.
      decomposition: CoACD's parameters.
      trials: placements by which solo stability is measured.
      jobs: worker processes; 0 takes one for each core.
      friction: sliding coefficient of every object, instead of 0.5 wherever it touches something.
      licence: on which terms the objects may be passed on, where their source does not say.
      attribution: whom to name, where the licence asks for it.
      settings: a TOML file of settings per object, in place of the objects.toml in each folder.
      add: add to the pool, which exists; objects of equal names are refused, or replaced with --force.
      force: make everything again, and replace a pool, a support, or with --add objects of that name.
      progress: show a progress bar (--no-progress to hide).
    """

    sources: tyro.conf.Positional[tuple[str, ...]] = ()
    pool: str | None = None
    support: str | None = None
    name: str | None = None
    tier: Literal["standard", "light"] = "standard"
    scale: float = 1.0
    up: Axis = "auto"
    front: Axis = "auto"
    density: float = 500.0
    mass: float | None = None
    max_texture: int = MAX_TEXTURE
    decomposition: DecompositionConfig = field(default_factory=DecompositionConfig)
    trials: int = 256
    jobs: int = 0
    friction: float | None = None
    licence: Annotated[str, tyro.conf.arg(aliases=["--license"])] = ""
    attribution: str = ""
    settings: Path | None = None
    add: bool = False
    force: bool = False
    progress: bool = True

    def run(self) -> int:
        """Runs the command: 0, or 1 if an object could not be imported."""
        if self.support is not None:
            refuse_given(self, _OF_OBJECTS, "with --support", "leaving it out: a table is not an object")
            return self._import_support(self.support)
        if self.pool is None or self.name is not None:
            raise ConfigError(
                "import with neither --pool nor --support" if self.pool is None else "--name with --pool",
                "SOURCES --pool NAME for objects, or --support FILE [--name NAME] for a table",
            )
        from cluttergen_jax.importing.run import import_pool

        report = import_pool(**keywords(self, without=("support", "name")))
        print_report(report)
        return 1 if report.failures else 0

    def _import_support(self, path: str) -> int:
        if self.sources or self.pool is not None:
            raise ConfigError("--support together with sources or --pool", "one of them", "two commands")
        from cluttergen_jax.importing.supports import import_support, user_supports

        ignored = ("sources", "pool", "support", "decomposition", "jobs", "progress", *_OF_OBJECTS)
        support = import_support(path, **keywords(self, without=ignored))
        x, y = support.region.half_extents
        print(
            f"{user_supports() / support.name}: top at {support.top:.3f} m, "
            f"made of {len(support.boxes)} boxes; "
            f"the queried region is {2 * x:.3f} x {2 * y:.3f} m\nUse it: --support {support.name}"
        )
        return 0


def print_report(report: ImportReport) -> None:
    """What was made, which axes were taken for up, what was skipped, and what failed, and why."""
    from cluttergen_jax.cli.pool_table import pool_table

    if report.objects:
        print(pool_table(report.objects))
        made = len(report.objects) - report.num_cached
        print(
            f"{report.path}: {len(report.objects)} objects ({made} made, {report.num_cached} from the cache)"
        )
    for (axis, reason), names in _grouped(
        [(each.axis, each.reason, n) for n, each in report.up_axes.items()]
    ):
        print(f"up is {axis} ({with_flags(reason, Import)}): {names}")
    if any(each.axis == "y" for each in report.up_axes.values()):
        print('  (an object that lies on its side: --up z, or up = "z" for its file in objects.toml)')
    if report.skipped:
        print(f"{len(report.skipped)} skipped:")
        for (reason,), names in _grouped([(each.reason, each.name) for each in report.skipped]):
            print(f"  {reason}: {names}")
    if report.failures:
        print(f"{len(report.failures)} failed:", file=sys.stderr)
        for failure in report.failures:
            # A source that could not be found is named in its reason already.
            is_named, reason = failure.reason.startswith(failure.name), with_flags(failure.reason, Import)
            print(f"  {reason if is_named else f'{failure.name}: {reason}'}", file=sys.stderr)


def _grouped(rows: Sequence[tuple[str, ...]]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Rows that agree in all but the last entry, which is a name: what they agree in, and the names."""
    for head, group in groupby(sorted(rows), key=lambda row: row[:-1]):
        yield head, ", ".join(row[-1] for row in group)
