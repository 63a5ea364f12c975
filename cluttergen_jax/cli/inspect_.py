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
      out: write a contact sheet to this PNG file; or to an HTML file a page to scroll through, flagged
        objects first, with a picture of each and what was measured.
      objects: only these, by names, patterns and conditions: "mug*", "label=*book* and mass<0.5".
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
        from cluttergen_jax.assets.facts import chosen_names
        from cluttergen_jax.assets.pool import find_pool
        from cluttergen_jax.cli.pool_table import pool_table
        from cluttergen_jax.errors import ConfigError
        from cluttergen_jax.files import check_file

        check_file(self.out, "out", f"{self.pool}.png")
        pool = find_pool(self.pool, self.exclude)
        chosen = chosen_names(pool.facts, self.objects, self.pool) if self.objects else pool.names
        objects = tuple(pool[name] for name in chosen)
        is_page = self.out is not None and self.out.suffix == ".html"
        if is_page and self.grasps:
            raise ConfigError("--grasps with an HTML page", "a PNG file", f"--out {self.pool}.png")
        print(f"pool {pool.name}, licence: {pool.licence or 'not stated'}, content {pool.hash[:12]}")
        print(pool_table(objects))
        if self.grasps:
            from cluttergen_jax.downstream.robot.api import robot_grasps

            print(sets := robot_grasps(self.pool, [asset.name for asset in objects]))
        if self.out is not None and is_page:
            from cluttergen_jax.rendering.pool_report import write_pool_report

            print(write_pool_report(self.out, pool, objects))
        elif self.out is not None:
            from cluttergen_jax.rendering.sheet import save_png

            if self.grasps:
                from cluttergen_jax.downstream.robot.grasping.picture import grasp_sheet

                image = grasp_sheet(objects, sets, self.columns)
            else:
                from cluttergen_jax.rendering.assets import object_sheet

                image = object_sheet(objects, self.columns)
            print(save_png(image, self.out))
        return 0
