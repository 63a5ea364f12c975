"""Agents: networks bound to a world's objects, which PPO trains and a policy acts with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.learning.networks import cloud_encoder
from cluttergen_jax.learning.networks.actor_critic import ActorCritic
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.networks.distributions import ActionDistribution
from cluttergen_jax.placement import Rules
from cluttergen_jax.placement.clouds import BARE, placed_points
from cluttergen_jax.placement.observation import ObservationConfig
from cluttergen_jax.types import Array

_SIDE = 64
_CELLS_OF_REGION = 48
_POINTS = 256
_EDGES = (BARE, 0.015, 0.03, 0.05, 0.08)
"""Metres above the support at which layers of height begin."""
_UNSURE = 0.004
"""Metres by which an underside may lie lower than the points of a cloud tell."""


class FootprintFeatures(struct.PyTreeNode, eq=False):
    """Footprints of K objects, ready to be slid over scenes. Pictures have S x S cells, axis 0 along x.

    Attributes:
      spectrum: c64[K, T, L, S, S / 2 + 1], conjugate, of the footprints at T turns, each cell in the layer in
        which the object's underside lies there; the layers sum to 1.
      below: f32[K, T, S + 1, S + 1], how much of a footprint lies before each corner of a cell.
      cloud: f32[K, P, 3], every object's, object frames, metres.
      cell: metres.
      num_cells: G, of the places along each side of the queried region.
    """

    spectrum: np.ndarray
    below: np.ndarray
    cloud: np.ndarray
    cell: float = struct.field(pytree_node=False)
    num_cells: int = struct.field(pytree_node=False)

    @staticmethod
    def of(
        cloud: Array,
        region_side: float,
        num_cells: int,
        num_turns: int,
        symmetry: int = 2,
        undersides: bool = False,
    ) -> FootprintFeatures:
        """Takes the footprints of clouds f32[K, P, 3].

        Args:
          region_side: metres, of a region that fills three quarters of a picture. In larger ones, places
            beyond the picture are told what is over its edge.
          num_turns: T, which divide a whole turn, or half of one where symmetry is 2.
          symmetry: 2 takes footprints both ways round, 1 as they are.
          undersides: whether what stands lower than an object's underside is not in its way; else everything
            below its footprint is.
        """
        cell = region_side / _CELLS_OF_REGION
        points = np.asarray(cloud, np.float64)[..., :2] / cell
        angles = (np.arange(num_turns) + 0.5) / num_turns * 2 * np.pi / symmetry
        cos = np.cos(angles)[:, None]
        sin = np.sin(angles)[:, None]
        heights = np.asarray(cloud, np.float64)[..., 2]
        underside = np.full((len(points), num_turns, _SIDE, _SIDE), np.inf)
        turn = np.arange(num_turns)[:, None]
        for picture, xy, z in zip(underside, points, heights, strict=True):
            x = cos * xy[:, 0] - sin * xy[:, 1]
            y = sin * xy[:, 0] + cos * xy[:, 1]
            for sign in (1, -1)[:symmetry]:
                np.minimum.at(
                    picture, (turn, _pixel(sign * x), _pixel(sign * y)), z - z.min() - _UNSURE
                )
        pictures = np.isfinite(underside).astype(np.float64)
        pictures /= pictures.sum((2, 3), keepdims=True)
        below = np.pad(pictures.cumsum(2).cumsum(3), [(0, 0), (0, 0), (1, 0), (1, 0)])
        edges = np.array(_EDGES if undersides else _EDGES[:1])
        layer = np.clip(np.searchsorted(edges, underside, side="right") - 1, 0, len(edges) - 1)
        layers = np.stack([pictures * (layer == number) for number in range(len(edges))], axis=2)
        spectrum = np.conj(np.fft.rfft2(np.fft.ifftshift(layers, axes=(-2, -1))))
        read = np.asarray(cloud)[:, :_POINTS]
        return FootprintFeatures(
            spectrum.astype(np.complex64), below.astype(np.float32), read, cell, num_cells
        )

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Of what it returns."""
        return (self.num_cells, self.num_cells, self.spectrum.shape[1], 2)

    def __call__(self, observation: Mapping[str, Any]) -> Array:
        """f32[G, G, T, 2]: shares of the footprint over other objects, and over what is not region.

        Args:
          observation: of `placement.observation.observe`, without a leading axis.
        """
        half = observation["region"][:2] / self.cell
        focus = observation["focus"]
        middle = (jnp.arange(self.num_cells) + 0.5) / self.num_cells * 2 - 1
        x = middle * half[0]
        y = middle * half[1]
        return jnp.stack(
            [self._over(observation, focus, x, y), self._beyond(focus, half, x, y)], axis=-1
        )

    def _over(self, observation: Mapping[str, Any], focus: Array, x: Array, y: Array) -> Array:
        """f32[G, G, T]: the correlation at x and y, f32[G], cells; an inverse transform at these alone."""
        taken = self._occupancy(observation["T_region_object"], observation["is_placed"])
        product = jnp.sum(jnp.fft.rfft2(taken) * jnp.asarray(self.spectrum)[focus], axis=1)
        x, y = (jnp.clip(axis, -_SIDE // 2, _SIDE // 2 - 1) for axis in (x, y))
        wave = np.fft.fftfreq(_SIDE)
        half_wave = np.fft.rfftfreq(_SIDE)
        twice = np.where((half_wave == 0) | (half_wave == 0.5), 1.0, 2.0)
        along = jnp.exp(2j * jnp.pi * x[:, None] * wave) / _SIDE
        across = jnp.exp(2j * jnp.pi * y[:, None] * half_wave) * twice / _SIDE
        return jnp.real(jnp.einsum("xu,tuv,yv->xyt", along, product, across))

    def _beyond(self, focus: Array, half: Array, x: Array, y: Array) -> Array:
        """f32[G, G, T]: what of the footprint is outside of the region's rectangle."""
        below = jnp.asarray(self.below)[focus]
        low, high = (
            (_SIDE // 2 + 0.5 + sign * half[:, None] - jnp.stack([x, y])) for sign in (-1, 1)
        )
        (i0, j0), (i1, j1) = (
            jnp.clip(jnp.rint(corner), 0, _SIDE).astype(jnp.int32) for corner in (low, high)
        )
        rows = below[:, i1] - below[:, i0]
        return 1 - jnp.moveaxis(rows[..., j1] - rows[..., j0], 0, -1)

    def _occupancy(self, T_region_object: Array, is_placed: Array) -> Array:
        """f32[L, S, S], 1 where an object reaches into a layer; the region's middle is at [0, 0]."""
        points = placed_points(jnp.asarray(self.cloud), T_region_object, is_placed)
        at = jnp.rint(points[..., :2] / self.cell).astype(jnp.int32)
        is_seen = jnp.all(jnp.abs(at) < _SIDE // 2, axis=-1) & is_placed[:, None]
        index = jnp.where(is_seen, at[..., 0] % _SIDE * _SIDE + at[..., 1] % _SIDE, _SIDE**2)
        top = jnp.zeros(_SIDE**2).at[index.reshape(-1)].max(points[..., 2].reshape(-1), mode="drop")
        edges = jnp.array(_EDGES[: self.spectrum.shape[2]], jnp.float32)
        return (top > edges[:, None]).astype(jnp.float32).reshape(-1, _SIDE, _SIDE)


def _pixel(position: np.ndarray) -> np.ndarray:
    """Of positions in cells from a picture's middle, which is pixel S / 2."""
    return np.clip(np.rint(position), -_SIDE // 2, _SIDE // 2 - 1).astype(int) + _SIDE // 2


Params = Any


ENCODER = "encoder"
"""Where the weights of the two networks on clouds are."""


class Agent(struct.PyTreeNode, eq=False):
    """An actor-critic that knows a world's point clouds; its action is a pose, f32[4] (docs/contract.md).

    Attributes:
      config: the network's sizes.
      cloud: f32[K, P, 3], every object's, object frames, metres.
      half_extents: f32[K, 3], metres.
      max_objects: the most objects that can stand at once.
      region_side: of the larger regions to be expected, metres.
      room: the objects' footprints, where the network reads them; made here if not given.
    """

    config: NetworkConfig = struct.field(pytree_node=False)
    cloud: Array
    half_extents: Array
    max_objects: int = struct.field(pytree_node=False)
    region_side: float = struct.field(pytree_node=False, default=0.7)
    room: FootprintFeatures | None = None

    def __post_init__(self) -> None:
        if self.config.reads_room and self.room is None:
            object.__setattr__(self, "room", self._footprints())

    @property
    def network(self) -> ActorCritic:
        """The module; its parameters depend on sizes in the config alone, not on the world."""
        return ActorCritic(self.config, self.max_objects)

    @property
    def observation(self) -> ObservationConfig:
        """How much of an episode it has to be shown."""
        return ObservationConfig(num_cells=self.config.num_cells_read)

    @property
    def encoder(self) -> cloud_encoder.CloudEncoder:
        """The networks on clouds, if there are any."""
        return cloud_encoder.CloudEncoder(self.config, self.max_objects)

    def _footprints(self) -> FootprintFeatures:
        config = self.config
        return FootprintFeatures.of(
            self.cloud,
            self.region_side,
            config.num_cells,
            config.num_turns,
            config.turn_symmetry,
            config.undersides,
        )

    def init(self, key: Array, observation: Any) -> Params:
        """Fresh parameters; `observation` is one, or its shapes, without a leading axis."""
        blank = jax.tree.map(lambda leaf: jnp.zeros((1, *leaf.shape), leaf.dtype), observation)
        if self.room is not None:
            blank |= {"room": jnp.zeros((1, *self.room.shape))}
        if not self.config.reads_clouds:
            return jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)
        key_encoder, key = jax.random.split(key)
        size = self.config.scene_features + self.config.object_features
        blank |= {"encoded": jnp.zeros((1, size))}
        params = jax.jit(self.network.init)(key, self.cloud, self.half_extents, blank)["params"]
        weights = cloud_encoder.init_encoder(
            self.encoder, key_encoder, self.cloud, self.half_extents
        )
        return {"params": params | {ENCODER: weights}}

    def apply(self, params: Params, observation: Any) -> tuple[ActionDistribution, Array]:
        """The action distribution and the values f32[B] of observations with a leading axis B."""
        observation = self._with_room(observation)
        if self.config.reads_clouds and "encoded" not in observation:
            observation = self._encode(params)(observation)
        return self.network.apply(params, self.cloud, self.half_extents, observation)

    def encode(self, params: Params) -> Callable[[Any], Any]:
        """A function that adds to observations with a leading axis what no later update changes.

        That is the room for the current object, and the features of a frozen encoder; those of an encoder
        that learns change with every step. `apply` takes it from there, however often it is called with that
        observation.
        """
        if self.config.reads_clouds and self.config.encoder_frozen:
            encode = self._encode(params)
            return lambda observation: encode(self._with_room(observation))
        return self._with_room

    def _with_room(self, observation: Any) -> Any:
        if self.room is None or "room" in observation:
            return observation
        return observation | {"room": jax.vmap(self.room)(observation)}

    def _encode(self, params: Params) -> Callable[[Any], Any]:
        weights = params["params"][ENCODER]
        weights = jax.lax.stop_gradient(weights) if self.config.encoder_frozen else weights
        objects = cloud_encoder.encode_objects(self.encoder, weights, self.cloud, self.half_extents)

        def encode(observation: Any) -> Any:
            scenes = cloud_encoder.encode_scenes(self.encoder, weights, self.cloud, observation)
            return observation | {
                "encoded": jnp.concatenate([scenes, objects[observation["focus"]]], axis=-1)
            }

        return encode


def make_agent(rules: Rules, network: NetworkConfig) -> Agent:
    """The agent of a network in a world."""
    geometry = rules.geometry
    return Agent(
        network,
        geometry.cloud,
        geometry.half_extents,
        min(rules.num_slots, geometry.num_objects),
        region_side=2 * float(rules.region.half_extents.max()),
    )
