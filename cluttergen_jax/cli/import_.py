"""`cluttergen import`: from meshes, URDF, MJCF or YCB to a pool of measured bodies, or to a support."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import tyro

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.errors import ConfigError

if TYPE_CHECKING:
    from cluttergen_jax.assets.readers import ReadOptions
    from cluttergen_jax.importing.run import ImportReport


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
      density: kg/m^3, where the mass is not known.
      mass: kilograms for every object, such as the paper's 0.1.
      decomposition: CoACD's parameters.
      trials: placements by which solo stability is measured.
      jobs: worker processes; 0 takes one for each core.
      force: make everything again, and replace a pool or a support of that name.
      progress: show a progress bar (--no-progress to hide).
    """

    sources: tyro.conf.Positional[tuple[str, ...]] = ()
    pool: str | None = None
    support: str | None = None
    name: str | None = None
    tier: Literal["standard", "light"] = "standard"
    scale: float = 1.0
    up: Literal["auto", "y", "z"] = "auto"
    density: float = 500.0
    mass: float | None = None
    decomposition: DecompositionConfig = field(default_factory=DecompositionConfig)
    trials: int = 256
    jobs: int = 0
    force: bool = False
    progress: bool = True

    def run(self) -> int:
        """Runs the command: 0, or 1 if an object could not be imported."""
        from cluttergen_jax.assets.body import BodyConfig
        from cluttergen_jax.assets.readers import ReadOptions
        from cluttergen_jax.importing.run import ImportConfig, import_sources
        from cluttergen_jax.importing.worker import ObjectConfig

        read = ReadOptions(self.scale, self.up, self.density, self.mass)
        if self.support is not None:
            return self._import_support(self.support, read)
        if self.pool is None or self.name is not None:
            raise ConfigError(
                "import with neither --pool nor --support" if self.pool is None else "--name with --pool",
                "SOURCES --pool NAME for objects, or --support FILE [--name NAME] for a table",
            )
        config = ObjectConfig(read, BodyConfig(self.tier, self.decomposition), self.trials)
        report = import_sources(
            self.sources, self.pool, ImportConfig(config, self.jobs, self.force, self.progress)
        )
        print_report(report)
        return report.status

    def _import_support(self, path: str, read: ReadOptions) -> int:
        from cluttergen_jax.importing.table import import_support

        if self.sources or self.pool is not None:
            raise ConfigError("--support together with sources or --pool", "one of them", "two commands")
        folder, support = import_support(path, self.name, read, self.force)
        x, y = support.region.half_extents
        print(
            f"{folder}: top at {support.top:.3f} m, made of {len(support.boxes)} boxes; "
            f"the queried region is {2 * x:.3f} x {2 * y:.3f} m\nUse it: --support {support.name}"
        )
        return 0


def print_report(report: ImportReport) -> None:
    """The table of what was made, and of what failed and why."""
    from cluttergen_jax.cli.pool_table import pool_table

    if report.objects:
        print(pool_table(report.objects))
        made = len(report.objects) - report.num_cached
        print(
            f"{report.path}: {len(report.objects)} objects ({made} made, {report.num_cached} from the cache)"
        )
    if report.failures:
        print(f"{len(report.failures)} failed:", file=sys.stderr)
        for failure in report.failures:
            # A source that could not be found is named in its reason already.
            is_named = failure.reason.startswith(failure.name)
            print(f"  {failure.reason if is_named else f'{failure.name}: {failure.reason}'}", file=sys.stderr)
