"""`cluttergen inspect`: a pool's table, and a picture of every mesh beside its parts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(frozen=True)
class Inspect:
    """Show what was measured about a pool's objects; draw each mesh beside its collision parts.

    Example: `cluttergen inspect dining --out dining.png`

    Attributes:
      pool: a pool's name or folder, or several joined by +.
      out: write a contact sheet to this PNG file.
      objects: only these.
      exclude: all but these.
      columns: objects in a row of the sheet.
      grasps: draw grasps of the Panda's hand about each object instead (extra `robot`); those that are not
        kept are found first, as `robot grasps` does.
    """

    pool: tyro.conf.Positional[str]
    out: Path | None = None
    objects: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    columns: int = 4
    grasps: bool = False

    def run(self) -> int:
        from cluttergen_jax.assets.pool import find_pool
        from cluttergen_jax.cli.pool_table import pool_table
        from cluttergen_jax.files import check_file

        check_file(self.out, "out", f"{self.pool}.png")
        pool = find_pool(self.pool, self.exclude)
        objects = tuple(pool[name] for name in self.objects) or pool.objects
        print(f"pool {pool.name}, licence: {pool.licence or 'not stated'}, content {pool.hash[:12]}")
        print(pool_table(objects))
        if self.grasps:
            from cluttergen_jax.downstream.robot.api import robot_grasps

            print(sets := robot_grasps(self.pool, [asset.name for asset in objects]))
        if self.out is not None:
            from cluttergen_jax.rendering.sheet import save_png

            if self.grasps:
                from cluttergen_jax.downstream.robot.grasping.picture import grasp_sheet

                image = grasp_sheet(objects, sets, self.columns)
            else:
                from cluttergen_jax.rendering.assets import object_sheet

                image = object_sheet(objects, self.columns)
            print(save_png(image, self.out))
        return 0
