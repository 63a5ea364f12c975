"""`cluttergen import`: from meshes, URDF, MJCF or YCB to a pool of measured bodies."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Literal

import tyro

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.decompose import DecompositionConfig
from cluttergen_jax.assets.readers import ReadOptions
from cluttergen_jax.cli.pool_table import pool_table
from cluttergen_jax.importing.run import ImportConfig, ImportReport, import_sources
from cluttergen_jax.importing.worker import ObjectConfig


@dataclass(frozen=True)
class Import:
    """Import objects as a pool: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, MJCF, folders of them, or `ycb`.

    Attributes:
      sources: files or folders; the word ycb stands for the 78 YCB objects (extra `ycb`).
      pool: the new pool's name.
      tier: standard (up to 32 convex parts), or light (one hull) for MJX in pure JAX.
      scale: factor from the files' unit to metres.
      up: the files' vertical axis; auto is y for GLTF, what a DAE file says, and z for all others.
      density: kg/m^3, where the mass is not known.
      mass: kilograms for every object, such as the paper's 0.1.
      decomposition: CoACD's parameters.
      trials: placements by which solo stability is measured.
      jobs: worker processes; 0 takes one for each core.
      force: make everything again, and replace a pool of that name.
      progress: show a progress bar (--no-progress to hide).
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    pool: str
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
        read = ReadOptions(self.scale, self.up, self.density, self.mass)
        config = ObjectConfig(read, BodyConfig(self.tier, self.decomposition), self.trials)
        report = import_sources(
            self.sources, self.pool, ImportConfig(config, self.jobs, self.force, self.progress)
        )
        print_report(report)
        return report.status


def print_report(report: ImportReport) -> None:
    """The table of what was made, and of what failed and why."""
    if report.objects:
        print(pool_table(report.objects))
        made = len(report.objects) - report.num_cached
        print(
            f"{report.path}: {len(report.objects)} objects ({made} made, {report.num_cached} from the cache)"
        )
    if report.failures:
        print(f"{len(report.failures)} failed:", file=sys.stderr)
        for failure in report.failures:
            print(f"  {failure.name}: {failure.reason}", file=sys.stderr)
