"""Whether `up` "auto" finds the pose in which people put objects: of files that are known to be right.

python -m studies.benchmarks.upright [--sources FOLDER ...] [--seeds 4] [--write]
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.mass import mass_properties
from cluttergen_jax.assets.pool import EMBEDDED, find_pool
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.solid import Solid, solid_of
from cluttergen_jax.assets.stances import Choice, usual_poses
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import find_sources, read_shape
from studies.benchmarks.section import prose, report, table

_NEAR = np.cos(np.radians(15))


@dataclass(frozen=True)
class Upright:
    """Turn objects at random, and count how many come back.

    Attributes:
      sources: folders of files that are upright; the embedded pools come first.
      seeds: random turns of each object.
      write: renew this program's section of reports/benchmarks.md.
    """

    sources: tuple[Path, ...] = ()
    seeds: int = 4
    write: bool = False

    def run(self) -> None:
        """Prints the table."""
        rows = []
        missed = []
        groups = [(name, _embedded(name)) for name in EMBEDDED]
        groups += [(folder.name, _read(folder)) for folder in self.sources]
        for group, objects in groups:
            counts = np.zeros(5)
            seconds: list[float] = []
            for name, solid, center in objects:
                found = [
                    _tried(solid, center, seed, seconds) for seed in (None, *range(self.seeds))
                ]
                authored = found[0]
                turned = np.array(found[1:], float)[:, :2].mean(0)
                counts += [1, authored[2], authored[0], *(authored[2] * turned)]
                if not authored[0] or turned[1] < 1:
                    missed.append(f"{name} ({turned[1]:.2f})")
            total = max(counts[1], 1)
            shares = [
                f"{counts[2] / counts[0]:.3f}",
                *(f"{count / total:.3f}" for count in counts[3:]),
            ]
            rows.append(
                [group, f"{counts[0]:.0f}", f"{counts[1]:.0f}", *shares, f"{max(seconds):.2f}"]
            )
        told = f"Not kept, or not always back (share): {', '.join(missed)}."
        body = "\n\n".join(["## Upright", _TEXT, table(_HEADER, rows), told])
        report("upright", body, write=self.write)


_HEADER = ("group", "objects", "stable", "kept", "turned: same", "same or flipped", "most CPU-s")
_TEXT = prose(
    """Objects whose files have them as people put them, as they are and turned at random. `stable`: those
    that can rest as authored, filled evenly; `kept`: of all, come out as authored if they are not turned;
    `turned`: of the stable ones, the share that comes back within 15 degrees, and with those upside down
    that look the same so."""
)


def _embedded(name: str) -> Iterator[tuple[str, Solid, np.ndarray]]:
    for asset in find_pool(name).objects:
        yield _solid(asset.name, asset.pieces)


def _read(folder: Path) -> Iterator[tuple[str, Solid, np.ndarray]]:
    for source in find_sources(folder):
        try:
            yield _solid(source.name, read_shape(source).pieces)
        except AssetError as error:
            print(f"left out: {error}")


def _solid(name: str, pieces: tuple[Piece, ...]) -> tuple[str, Solid, np.ndarray]:
    solid = solid_of([piece.mesh for piece in pieces])
    return name, solid, mass_properties(solid.mesh, 500.0).center


def _tried(
    solid: Solid, center: np.ndarray, seed: int | None, seconds: list[float]
) -> tuple[bool, bool, bool]:
    """Whether the object comes back as it was, or so that it looks like it, and whether it can rest so."""
    turn = np.eye(3) if seed is None else Rotation.random(random_state=seed).as_matrix()
    mesh = solid.mesh.transform(turn, np.zeros(3))
    start = time.process_time()
    choice = usual_poses(Solid(mesh, solid.is_exact, mesh), turn @ center)
    seconds.append(time.process_time() - start)
    up = turn.T @ _up(choice)
    is_same = bool(up[2] > _NEAR)
    return (
        is_same,
        is_same or (up[2] < -_NEAR and _flips(solid, center)),
        choice.authored is not None,
    )


def _up(choice: Choice) -> np.ndarray:
    return np.array([0.0, 0.0, 1.0]) if choice.is_kept else choice.poses[0][0].up


def _flips(solid: Solid, center: np.ndarray) -> bool:
    """Whether it looks nearly the same upside down: 97 % of its surface, within 3 % of its size."""
    points = sample_surface(solid.mesh, 6000, 0) - center
    flipped = points[:400] * [1, 1, -1]
    away, _ = cKDTree(points).query(flipped, distance_upper_bound=0.03 * solid.diagonal)
    return bool(np.isfinite(away).mean() > 0.97)


if __name__ == "__main__":
    tyro.cli(Upright).run()
