"""`cluttergen import`: from meshes, URDF, SDF, MJCF or YCB to a pool of measured bodies, or to a support."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import Positional, arg

from cluttergen_jax.api.import_ import import_pool, import_support
from cluttergen_jax.cli.import_report import print_report
from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.errors import ConfigError


@options_from(
    import_pool,
    import_support,
    sources=Positional[tuple[str, ...]],
    pool=str | None,
    path=Annotated[str | None, arg(name="support")],
    licence=Annotated[str, arg(aliases=["--license"])],
)
class Import(Options):
    """Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, SDF, MJCF, or `ycb`.

    Example: `cluttergen import my_meshes/ --pool mine --scale 0.001`
    """

    def run(self) -> int:
        """Runs the command: 0, or 1 if an object could not be imported, or none was."""
        if self.path is not None:
            return self._import_support()
        if self.pool is None or self.name is not None:
            raise ConfigError(
                "import with neither --pool nor --support" if self.pool is None else "--name with --pool",
                "SOURCES --pool NAME for objects, or --support FILE [--name NAME] for a table",
            )
        report = self.call(import_pool)
        print_report(report, Import)
        return 1 if report.failures or not report.objects else 0

    def _import_support(self) -> int:
        if self.sources or self.pool is not None:
            raise ConfigError("--support together with sources or --pool", "one of them", "two commands")
        from cluttergen_jax.assets.support_file import user_supports

        ignored = ("decomposition", "jobs", "time_limit", "progress", "cluster", "workers")
        hint = "leaving it out: a table is not an object"
        support = self.call(import_support, "with --support", hint, ignored)
        x, y = support.region.half_extents
        print(
            f"{user_supports() / support.name}: top at {support.top:.3f} m, "
            f"made of {len(support.boxes)} boxes; "
            f"the queried region is {2 * x:.3f} x {2 * y:.3f} m\nUse it: --support {support.name}"
        )
        return 0
