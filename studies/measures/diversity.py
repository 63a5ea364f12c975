"""Diversity measures of a method's scenes: no reference set is needed.

Every one of these figures depends on how many scenes there are. Between methods only figures at equal counts
may be compared: `at_equal_count` draws as many scenes from each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve, label
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError, range_text
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.judging.scene_models import check_scenes

CELL = 0.05


@dataclass(frozen=True, eq=False)
class PlanEntropy:
    """How evenly each object is spread over the region in plan view. K objects.

    Attributes:
      count: i64[K], scenes in which the object stands.
      entropy: f64[K], nats, Miller-Madow corrected; NaN where the object never stands.
      plain: f64[K], nats, of the shares as they are: too low by about (occupied - 1) / (2 count).
      evenness: f64[K], entropy over that of an even spread over all cells, in [0, 1].
      area: f64[K], m^2, exp(entropy) cells: the area over which an even spread has this entropy.
      num_cells: cells of the grid.
    """

    count: np.ndarray
    entropy: np.ndarray
    plain: np.ndarray
    evenness: np.ndarray
    area: np.ndarray
    num_cells: int


def plan_entropy(
    poses: np.ndarray, is_placed: np.ndarray, region: Rectangle, cell: float = CELL
) -> PlanEntropy:
    """Entropy of each object's position on a grid over the region, corrected for the number of scenes.

    Miller and Madow's correction (1955) adds (m - 1) / (2 n), m the occupied cells and n the scenes; the
    result is kept between 0 and that of an even spread. With nearly twice as many scenes as cells it removes
    two thirds of the bias of an even spread; with fewer, compare at equal counts.

    Args:
      poses: f[N, K, 7], world, metres; is_placed: bool[N, K].
      cell: the side of a cell at most, metres; cells fill the region exactly.
    """
    check_scenes(poses, is_placed)
    is_placed = np.asarray(is_placed, bool)
    cells, shape = cell_of(region_positions(poses, region), region, cell)
    num_cells = int(np.prod(shape))
    rows = [_entropy(np.bincount(cells[here, k])) for k, here in enumerate(is_placed.T)]
    plain, occupied = np.array(rows).reshape(-1, 2).T
    count = is_placed.sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        corrected = plain + (occupied - 1) / (2 * count)
    entropy = np.where(count > 0, np.clip(corrected, 0.0, np.log(num_cells)), np.nan)
    side = 4 * np.prod(region.half_extents) / num_cells
    evenness = entropy / np.log(num_cells) if num_cells > 1 else np.zeros_like(entropy)
    return PlanEntropy(count, entropy, plain, evenness, np.exp(entropy) * side, num_cells)


def _entropy(counts: np.ndarray) -> tuple[float, int]:
    """Nats of the shares that counts i[C] give, and how many of them are above zero."""
    counts = counts[counts > 0]
    if not len(counts):
        return float("nan"), 0
    share = counts / counts.sum()
    return float(-(share * np.log(share)).sum()), len(counts)


def cell_of(
    positions: np.ndarray, region: Rectangle, cell: float
) -> tuple[np.ndarray, tuple[int, int]]:
    """The cells i64[...] of positions f[..., 2] in the region's frame, and the grid's shape.

    What lies outside counts for the nearest cell.

    Raises:
      ConfigError: the cell is not a length.
    """
    if not (np.isfinite(cell) and cell > 0):
        raise ConfigError(f"a cell of {cell} m", "a length above zero", f"{CELL}")
    half = np.asarray(region.half_extents)
    shape = np.maximum(np.ceil(2 * half / cell - 1e-9), 1).astype(int)
    place = np.clip(((positions + half) / (2 * half) * shape).astype(int), 0, shape - 1)
    return place[..., 0] * shape[1] + place[..., 1], (int(shape[0]), int(shape[1]))


def plan_box_area(poses: np.ndarray, is_placed: np.ndarray, region: Rectangle) -> np.ndarray:
    """f64[K], m^2: the rectangle between each object's extreme positions (paper, diversity maps).

    It is the paper's measure, given for comparison: outliers decide it. NaN where the object never stands.
    """
    check_scenes(poses, is_placed)
    positions = region_positions(poses, region)
    areas = [np.ptp(positions[here, k], axis=0).prod() if here.any() else np.nan
             for k, here in enumerate(np.asarray(is_placed, bool).T)]  # fmt: skip
    return np.array(areas, np.float64)


EDGE_BAND = 0.1
"""Of a region's side: what lies nearer to an end of it lies along an edge."""


_CROWDED = 3.0


_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])


def edge_share(
    poses: np.ndarray, is_placed: np.ndarray, region: Rectangle, band: float = EDGE_BAND
) -> np.ndarray:
    """f64[K]: how often each object lies within `band` of a side's length from that side's ends.

    An even spread has 1 - (1 - 2 band)^2, 0.36 for a tenth. NaN where the object never stands.
    """
    check_scenes(poses, is_placed)
    if not 0 < band <= 0.5:
        raise ConfigError(
            f"a band of {band}", "a share of the side, above 0 and at most a half", f"{EDGE_BAND}"
        )
    inside = (1 - 2 * band) * np.asarray(region.half_extents)
    is_near = (np.abs(region_positions(poses, region)) > inside).any(-1)
    return np.array(
        [
            is_near[here, k].mean() if here.any() else np.nan
            for k, here in enumerate(np.asarray(is_placed, bool).T)
        ]
    )


def plan_clusters(
    poses: np.ndarray, is_placed: np.ndarray, region: Rectangle, cell: float = CELL
) -> tuple[np.ndarray, np.ndarray]:
    """Clusters of each object's positions: groups of neighbouring cells with three times an even share.

    A cell is counted together with its four neighbours, so that few scenes make no clusters by chance.

    Returns:
      f64[K], the number of such groups, and f64[K], the share of scenes in which the object lies in one of
      them; NaN where it never stands.
    """
    check_scenes(poses, is_placed)
    cells, shape = cell_of(region_positions(poses, region), region, cell)
    found = []
    for k, here in enumerate(np.asarray(is_placed, bool).T):
        if not here.any():
            found.append((np.nan, np.nan))
            continue
        counts = (
            np.bincount(cells[here, k], minlength=int(np.prod(shape))).reshape(shape).astype(float)
        )
        # A cross of five cells; the outermost have fewer neighbours.
        sums, sizes = (convolve(each, _CROSS, mode="constant") for each in (counts, np.ones(shape)))
        is_crowded = sums / sizes > _CROWDED * counts.mean()
        found.append((float(label(is_crowded)[1]), counts[is_crowded].sum() / counts.sum()))
    numbers, shares = np.array(found, np.float64).reshape(-1, 2).T
    return numbers, shares


def nearest_distance(vectors: np.ndarray) -> np.ndarray:
    """f64[N], metres: how far the nearest other scene is, for scenes f[N, D] from `embed`, N >= 2.

    Near zero for a method that repeats itself. Shrinks as N grows.
    """
    if len(vectors) < 2:
        raise ConfigError(f"nearest neighbours among {len(vectors)} scenes", "two or more scenes")
    return cKDTree(vectors).query(vectors, k=2)[0][:, 1]


def scene_kernel(
    vectors: np.ndarray, region: Rectangle, bandwidth: float | None = None
) -> np.ndarray:
    """f64[N, N]: exp(-d^2 / (2 s^2)) of the scene distance d: 1 for equal scenes, positive semi-definite.

    Args:
      bandwidth: s in metres; None takes half of `independent_distance`, which the region alone
        decides, so that methods on one region are measured alike. Scenes of independent, even placements then
        have similarities of about 0.14.
    """
    bandwidth = independent_distance(region) / 2 if bandwidth is None else bandwidth
    return np.exp(-np.square(cdist(vectors, vectors)) / (2 * bandwidth**2))


def vendi_score(kernel: np.ndarray) -> float:
    """The effective number of different scenes (Friedman and Dieng, "The Vendi Score", 2023).

    exp(-sum l log l) over the eigenvalues l of the kernel over N. N equal scenes give 1, N scenes without any
    similarity give N.

    Args:
      kernel: f[N, N], symmetric, positive semi-definite, ones on its diagonal.

    Raises:
      ConfigError: it is not such a matrix.
    """
    kernel = np.asarray(kernel, np.float64)
    is_square = kernel.ndim == 2 and kernel.shape[0] == kernel.shape[1] > 0
    if not is_square or not np.allclose(np.diag(kernel), 1) or not np.allclose(kernel, kernel.T):
        raise ConfigError(
            f"a kernel of shape {kernel.shape}",
            "a symmetric matrix with ones on its diagonal",
            "scene_kernel",
        )
    values = np.linalg.eigvalsh(kernel / len(kernel))
    if values.min() < -1e-8:
        raise ConfigError(
            f"a kernel with an eigenvalue of {values.min():.2g}", "a positive semi-definite matrix"
        )
    values = values[values > 1e-15]
    return float(np.exp(-(values * np.log(values)).sum()))


def at_equal_count(
    measure: Callable[[np.ndarray], float],
    num_scenes: int,
    count: int,
    num_draws: int = 20,
    seed: int = 0,
) -> tuple[float, float]:
    """A measure of `count` scenes drawn from more, so that methods can be compared that left unequal numbers.

    Args:
      measure: of scene indices i64[count], each scene at most once.
      num_scenes: how many there are.
      num_draws: draws that are averaged; one is enough where all scenes are taken.

    Returns:
      The mean over draws and their standard deviation.

    Raises:
      ConfigError: fewer scenes than are asked for.
    """
    if not 1 <= count <= num_scenes:
        raise ConfigError(f"{count} scenes drawn from {num_scenes}", range_text(1, num_scenes))
    rng = np.random.default_rng(seed)
    draws = 1 if count == num_scenes else num_draws
    values = [measure(rng.choice(num_scenes, count, replace=False)) for _ in range(draws)]
    return float(np.mean(values)), float(np.std(values))


def independent_distance(region: Rectangle) -> float:
    """Metres: the root mean square distance of two positions drawn evenly from the region, turns left out.

    Scenes of independent, even placements are about so far apart; a yardstick that depends on the region
    alone.
    """
    return float(np.sqrt(2 * (np.square(region.half_extents) / 3).sum()))


def region_positions(poses: np.ndarray, region: Rectangle) -> np.ndarray:
    """f64[..., 2]: where poses f[..., 7] lie in the region's frame, metres from its centre."""
    offset = np.asarray(poses, np.float64)[..., :2] - np.asarray(region.center)
    return rotate_in_plane(offset, -region.yaw)
