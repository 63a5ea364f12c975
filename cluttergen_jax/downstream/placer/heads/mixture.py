"""The head `mixture`: a distribution over cells and turns of the region, fitted to where objects stand."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.downstream.placer.heads.features import UNSEEN, occupancy_around
from cluttergen_jax.downstream.placer.map_search import best_apart
from cluttergen_jax.downstream.placer.query import (
    NUM_PROPOSALS,
    Example,
    PlacementQuery,
    Proposals,
    without_scores,
)
from cluttergen_jax.learning.networks.distributions import EDGE, Mixture
from cluttergen_jax.placement.heightmap import VOID
from cluttergen_jax.placement.search import (
    CLEARANCE,
    Candidates,
    cells_under,
    lower_onto,
    mean_under,
)
from cluttergen_jax.types import Array

NUM_CELL_FEATURES = 13
_MIDDLE = 0.5


@dataclass(frozen=True)
class MixtureConfig:
    """Sizes of the mixture and of its network.

    Attributes:
      num_cells: along each side of the region; num_turns: ranges of a whole turn.
      widths: of the layers at each cell and turn.
      num_columns: of the object's columns that are lowered there.
    """

    num_cells: int = 20
    num_turns: int = 16
    widths: tuple[int, ...] = (48, 32)
    num_columns: int = 32


class MixtureNet(nn.Module):
    """The same small network at every cell and turn."""

    config: MixtureConfig = MixtureConfig()

    @nn.compact
    def __call__(self, features: Array) -> Mixture:
        """The mixture of one query, over x, y and turn: z is the same everywhere (`MixturePlacer`).

        Args:
          features: f32[G * G * T, NUM_CELL_FEATURES], of the cells' middles (`cell_features`).
        """
        config = self.config
        hidden = features
        for width in config.widths:
            hidden = nn.relu(nn.Dense(width)(hidden))
        scores = nn.Dense(1, kernel_init=nn.initializers.zeros)(hidden)[..., 0]
        x, y, turn = self.param("inside", nn.initializers.zeros, (3, 2))
        raw = jnp.stack([x, y, jnp.zeros(2), turn])
        side = (config.num_cells, config.num_cells)
        return Mixture.from_scores(
            scores.reshape(*side, config.num_turns),
            raw,
            jnp.zeros(side),
            jnp.float32(1.0),
            symmetry=1,
        )


def cells_of(query: PlacementQuery, config: MixtureConfig) -> Candidates:
    """The middles of all cells and turns, in the order of the mixture's components."""
    place = (np.arange(config.num_cells) + 0.5) / config.num_cells * 2 - 1
    turn = (np.arange(config.num_turns) + 0.5) / config.num_turns * 2 * np.pi
    grid = np.stack(
        np.meshgrid(place, place, turn, indexing="ij"), axis=-1, dtype=np.float32
    ).reshape(-1, 3)
    return Candidates(grid[:, :2] * query.region_half_extents, jnp.asarray(grid[:, 2]))


def cell_features(query: PlacementQuery, config: MixtureConfig) -> Array:
    """f32[G * G * T, NUM_CELL_FEATURES]: how the object would lie at the middle of each cell and turn."""
    cells = cells_of(query, config)
    under = query.under.first(config.num_columns)
    columns = []
    for surface in (query.heights, query.ceilings):
        fit = lower_onto(under, surface, cells)
        columns += [
            10 * jnp.clip(fit.rest - query.half_extents[2], -0.05, 0.3),
            fit.blocked,
            100 * jnp.clip(fit.gap, 0.0, 0.03),
            mean_under(under, occupancy_around(surface), cells),
        ]
    below = cells_under(under, query.heights, cells)
    hidden = query.ceilings.at(below) - query.heights.at(below)
    number = jnp.maximum(under.is_column.sum(), 1)
    columns.append(jnp.where(under.is_column, hidden > UNSEEN, False).sum(1) / number)
    columns.append(
        jnp.where(under.is_column, query.heights.at(below) <= VOID, False).sum(1) / number
    )
    inside = query.region_half_extents - jnp.abs(cells.xy)
    columns.append(10 * jnp.clip(jnp.min(inside, axis=1), 0.0, 0.1))
    size = 10 * jnp.stack([jnp.linalg.norm(query.half_extents[:2]), query.half_extents[2]])
    columns += list(jnp.broadcast_to(size[:, None], (2, len(cells.yaw))))
    return jnp.stack(columns, axis=1)


def mass_around(mass: Array) -> Array:
    """f32[G, G, T]: the mass of each cell and turn and of all beside it; nothing is beyond the region."""
    # Turns go round.
    mass = jnp.concatenate([mass[..., -1:], mass, mass[..., :1]], axis=-1)
    return jax.lax.reduce_window(
        mass, 0.0, jax.lax.add, (3, 3, 3), (1, 1, 1), ((1, 1), (1, 1), (0, 0))
    )


class MixturePlacer(struct.PyTreeNode, eq=False):
    """Proposes the middles of the likeliest neighbourhoods of cells and turns, lowered onto what was seen.

    The likeliest cell alone is often the only good one around, such as the lid of a box, from which an object
    falls that is put down beside it.

    Attributes:
      params: the network's weights; config: its sizes.
    """

    params: Any
    config: MixtureConfig = struct.field(pytree_node=False, default=MixtureConfig())

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        """See `query.Placer`; nothing is drawn."""
        del key
        found: Any = MixtureNet(self.config).apply(self.params, cell_features(query, self.config))
        cells = cells_of(query, self.config)
        shape = (*[self.config.num_cells] * 2, self.config.num_turns)
        mass = mass_around(jnp.exp(found.log_weight).reshape(shape)).ravel()
        best = best_apart(-mass, cells.xy, NUM_PROPOSALS)
        inside = found.inside.mean() - _MIDDLE
        step = jnp.append(2 * query.region_half_extents / self.config.num_cells, 0.0)
        turn = 2 * jnp.pi / self.config.num_turns
        chosen = Candidates(
            cells.xy[best] + (step[:2] * inside[:2]), cells.yaw[best] + turn * inside[3]
        )
        z = lower_onto(query.under, query.heights, chosen).rest + CLEARANCE
        return without_scores(jnp.column_stack([chosen.xy, z, chosen.yaw]))


class MixtureExample(struct.PyTreeNode):
    """What the network learns from one pair.

    Attributes:
      features: f16[G * G * T, NUM_CELL_FEATURES]; action: f32[4], the object's pose in (0, 1).
    """

    features: Array
    action: Array


@dataclass(frozen=True)
class MixtureHead:
    """Learns by negative log-likelihood from where the object stands in the scene."""

    config: MixtureConfig = field(default_factory=MixtureConfig)
    kind = "mixture"

    def prepare(self, example: Example) -> MixtureExample:
        query = example.query
        target = example.target
        place = (target[:2] / query.region_half_extents + 1) / 2
        turn = jnp.mod(target[3] / (2 * jnp.pi), 1.0)
        action = jnp.stack([place[0], place[1], jnp.float32(_MIDDLE), turn])
        features = cell_features(query, self.config).astype(jnp.float16)
        return MixtureExample(features, jnp.clip(action, EDGE, 1 - EDGE))

    def init(self, key: Array) -> Any:
        number = self.config.num_cells**2 * self.config.num_turns
        return MixtureNet(self.config).init(key, jnp.zeros((number, NUM_CELL_FEATURES)))

    def loss(
        self, params: Any, examples: MixtureExample, key: Array
    ) -> tuple[Array, dict[str, Array]]:
        del key

        def surprise(example: MixtureExample) -> Array:
            found: Any = MixtureNet(self.config).apply(params, example.features.astype(jnp.float32))
            return -found.log_prob(example.action)

        total = jax.vmap(surprise)(examples).mean()
        return total, {"nll": total}

    def placer(self, params: Any, temperature: float = 1.0) -> MixturePlacer:
        return MixturePlacer(params, self.config)
