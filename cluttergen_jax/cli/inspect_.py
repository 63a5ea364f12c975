"""`cluttergen inspect`: a pool's or a support's table, and pictures of what was measured of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from cluttergen_jax.assets.support import SupportAsset


@dataclass(frozen=True)
class Inspect:
    """Show what was measured about objects of a pool, or surfaces of a support; draw it.

    Example: `cluttergen inspect dining --out dining.png`

    Attributes:
      pool: a pool's name or folder, or several joined by +; or a support's name or folder, of which surfaces
        are listed, and drawn with their numbers.
      out: write a contact sheet to this PNG file; or to an HTML file a page to scroll through, flagged
        objects first, with a picture of each and what was measured.
      objects: only these, by names, patterns and conditions: "mug*", "label=*book* and mass<0.5".
      exclude: all but these.
      columns: objects in a row of the sheet.
      grasps: draw grasps of the Panda's hand about each object instead (extra `robot`); those that are not
        kept are found first, as `robot grasps` does.
    """

    pool: tyro.conf.Positional[str]
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="(optional)")] = (
        None
    )
    objects: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    columns: int = 4
    grasps: bool = False

    def run(self) -> int:
        from cluttergen_jax.files import check_file
        from cluttergen_jax.kept_folder import hold_file

        check_file(self.out, "out", f"{self.pool}.png")
        with hold_file(self.out):
            return self._inspect()

    def _inspect(self) -> int:
        from cluttergen_jax.assets.facts import chosen_names
        from cluttergen_jax.assets.pool import find_pool
        from cluttergen_jax.cli.pool_table import pool_table
        from cluttergen_jax.errors import ConfigError

        if (support := _support_called(self.pool)) is not None:
            return self._inspect_support(support)
        pool = find_pool(self.pool, self.exclude)
        chosen = chosen_names(pool.facts, self.objects, self.pool) if self.objects else pool.names
        objects = tuple(pool[name] for name in chosen)
        is_page = self.out is not None and self.out.suffix == ".html"
        if is_page and self.grasps:
            raise ConfigError("--grasps with an HTML page", "a PNG file", f"--out {self.pool}.png")
        print(
            f"pool {pool.name}, licence: {pool.licence or 'not stated'}, content {pool.hash[:12]}"
        )
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

    def _inspect_support(self, support: SupportAsset) -> int:
        from cluttergen_jax.errors import ConfigError

        is_page = self.out is not None and self.out.suffix != ".png"
        if self.objects or self.exclude or self.grasps or is_page:
            raise ConfigError(
                f"options about objects, or an HTML page, with support {support.name!r}",
                "its name, and --out with a PNG file",
                f"cluttergen inspect {self.pool} --out {support.name}.png",
            )
        solids = f"{len(support.boxes)} boxes, {len(support.parts)} convex parts"
        print(f"support {support.name} ({support.label}), collision: {solids}")
        print(surface_table(support))
        if self.out is not None:
            from cluttergen_jax.rendering.assets import support_sheet
            from cluttergen_jax.rendering.sheet import save_png

            print(save_png(support_sheet(support), self.out))
        return 0


def _support_called(name: str) -> SupportAsset | None:
    """The support of a name or folder; None where there is a pool called so, or nothing."""
    from cluttergen_jax.assets.pool import list_pools
    from cluttergen_jax.assets.support_file import find_support, is_support

    return find_support(name) if name not in list_pools() and is_support(name) else None


def surface_table(support: SupportAsset) -> str:
    """A row for each surface: number, name, height, slope, area, region, free height; metres, degrees."""
    rows = [("", "surface", "height", "slope", "area", "region", "free height above")]
    for number, each in enumerate(support.surfaces, 1):
        x, y = each.region.half_extents
        free = "open" if math.isinf(each.free_height) else f"{each.free_height:.3f} m"
        slope = "level" if each.is_level else f"{math.degrees(each.tilt):.1f} deg"
        rows.append(
            (
                str(number),
                each.name,
                f"{each.position[2]:.3f} m",
                slope,
                f"{each.area:.3f} m^2",
                f"{2 * x:.2f} x {2 * y:.2f} m",
                free,
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join(
        "  ".join(t.ljust(w) for t, w in zip(row, widths, strict=True)).rstrip() for row in rows
    )
