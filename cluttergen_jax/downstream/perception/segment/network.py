"""The segmentation network: a small U-Net on colour, depth and height, with a vote for objects' centres."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.downstream.perception.types import BACKGROUND, FIRST_OBJECT, num_classes
from cluttergen_jax.types import Array

# Pixels of what the network reads and answers.
WIDTH = 160
HEIGHT = 120

NO_DEPTH = -8.0
"""In place of metres where nothing was measured."""
_COLOUR = 3
_GROUPS = 8
_VOTE_SCALE = 20.0
"""Pixels; votes are told in these."""
_OBJECT_WEIGHT = 3.0
_VOTE_WEIGHT = 0.3
_NEAR = 0.8
_DEPTH_SCALE = 0.4
_HEIGHT_SCALE = 0.1


@dataclass(frozen=True)
class SegmentConfig:
    """Sizes of the network.

    Attributes:
      num_objects: K, that it knows.
      widths: channels at a half, a quarter, an eighth and a sixteenth of the picture.
      colour: read colours too; False for depth alone.
    """

    num_objects: int
    widths: tuple[int, int, int, int] = (24, 48, 80, 96)
    colour: bool = True


class Block(nn.Module):
    """Two convolutions of 3 x 3, each normalised over groups of channels."""

    width: int

    @nn.compact
    def __call__(self, x: Array) -> Array:
        for _ in range(2):
            x = nn.Conv(self.width, (3, 3), use_bias=False)(x)
            x = nn.relu(nn.GroupNorm(num_groups=_GROUPS)(x))
        return x


class SegmentNet(nn.Module):
    """A U-Net; its first and last layers work on squares of 2 x 2 pixels."""

    config: SegmentConfig

    @nn.compact
    def __call__(self, images: Array) -> tuple[Array, Array]:
        """Logits f32[B, H, W, C] of the classes; votes f32[B, H, W, 2], in `_VOTE_SCALE`, right and down.

        Args:
          images: f32[B, H, W, 5], as `network_images` makes them.
        """
        first, *deeper = self.config.widths
        x = _space_to_depth(images if self.config.colour else images[..., _COLOUR:])
        skips = [x := Block(first)(x)]
        for width in deeper:
            x = nn.max_pool(x, (2, 2), (2, 2), padding="SAME")
            skips.append(x := Block(width)(x))
        for skip in skips[-2::-1]:
            x = jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)[:, : skip.shape[1]]
            x = nn.Conv(skip.shape[-1], (1, 1))(x) + skip
            x = Block(skip.shape[-1])(x)
        number = num_classes(self.config.num_objects)
        out = _depth_to_space(nn.Conv(4 * (number + 2), (1, 1))(x))
        return out[..., :number], out[..., number:]


def _space_to_depth(x: Array) -> Array:
    """f[B, H/2, W/2, 4 C]: squares of pixels as one."""
    b, h, w, c = x.shape
    return (
        x.reshape(b, h // 2, 2, w // 2, 2, c)
        .transpose(0, 1, 3, 2, 4, 5)
        .reshape(b, h // 2, w // 2, 4 * c)
    )


def _depth_to_space(x: Array) -> Array:
    """The inverse of `_space_to_depth`."""
    b, h, w, c = x.shape
    return (
        x.reshape(b, h, w, 2, 2, c // 4)
        .transpose(0, 1, 3, 2, 4, 5)
        .reshape(b, 2 * h, 2 * w, c // 4)
    )


class SegmentExample(struct.PyTreeNode):
    """One view to learn from, at the network's size.

    Attributes:
      rgb: u8[H, W, 3]. depth, height: f16[H, W], metres, the latter over the table; `NO_DEPTH` where none.
      label: u8[H, W], see `types`.
      center: f32[K, 2], pixels right and down, where the objects' middles are seen.
    """

    rgb: Array
    depth: Array
    height: Array
    label: Array
    center: Array


def network_images(rgb: Array, depth: Array, height: Array) -> Array:
    """f32[..., H, W, 5] of what `SegmentExample` has, each about as large as 1."""
    depth = depth.astype(jnp.float32)
    height = height.astype(jnp.float32)
    is_there = depth > 0
    far = jnp.where(is_there, (depth - _NEAR) / _DEPTH_SCALE, -2.0)
    high = jnp.where(is_there, jnp.clip(height / _HEIGHT_SCALE, -2.0, 4.0), -2.0)
    light = rgb / 255.0
    axes = (-3, -2, -1)
    # Whatever the exposure, a picture is as bright and as rich in contrast as any other.
    light = (light - light.mean(axes, keepdims=True)) / (light.std(axes, keepdims=True) + 0.01)
    return jnp.concatenate([light, jnp.stack([far, high], axis=-1)], axis=-1)


@dataclass(frozen=True)
class SegmentLearner:
    """Learns classes by cross-entropy, pixels of objects weighing more, and votes by their distance."""

    config: SegmentConfig = field(default_factory=lambda: SegmentConfig(1))

    def init(self, key: Array) -> Any:
        """Fresh weights."""
        return SegmentNet(self.config).init(key, jnp.zeros((1, HEIGHT, WIDTH, 5)))

    def loss(
        self, params: Any, examples: SegmentExample, key: Array
    ) -> tuple[Array, dict[str, Array]]:
        """See `fitting.Learner`; as coins fall views are mirrored, and their backgrounds recoloured."""
        number = len(examples.label)
        flip_key, colour_key = jax.random.split(key)
        examples = jax.vmap(_mirror)(examples, jax.random.bernoulli(flip_key, shape=(number, 2)))
        examples = jax.vmap(_recolour)(examples, jax.random.split(colour_key, number))
        images = network_images(examples.rgb, examples.depth, examples.height)
        logits, votes = self._answers(params, images)
        label = examples.label.astype(jnp.int32)
        is_object = label >= FIRST_OBJECT
        weight = jnp.where(is_object, _OBJECT_WEIGHT, 1.0)
        each = optax.softmax_cross_entropy_with_integer_labels(logits, label)
        classes = (each * weight).sum() / weight.sum()
        target = jax.vmap(lambda center, label: center[jnp.maximum(label - FIRST_OBJECT, 0)])(
            examples.center, label
        )
        place = jnp.stack(jnp.meshgrid(jnp.arange(WIDTH) + 0.5, jnp.arange(HEIGHT) + 0.5), axis=-1)
        error = optax.huber_loss(votes, (target - place) / _VOTE_SCALE).sum(-1)
        vote = (error * is_object).sum() / jnp.maximum(is_object.sum(), 1)
        return classes + _VOTE_WEIGHT * vote, {"classes": classes, "votes": vote}

    def answers(self, params: Any, images: Array) -> tuple[Array, Array]:
        """Probabilities f32[B, H, W, C]; where pixels say that their object's centre is, f32[B, H, W, 2]."""
        logits, votes = self._answers(params, images)
        place = jnp.stack(jnp.meshgrid(jnp.arange(WIDTH) + 0.5, jnp.arange(HEIGHT) + 0.5), axis=-1)
        return jax.nn.softmax(logits), place + _VOTE_SCALE * votes

    def _answers(self, params: Any, images: Array) -> tuple[Array, Array]:
        found: Any = SegmentNet(self.config).apply(params, images)
        return found


def _mirror(example: SegmentExample, flips: Array) -> SegmentExample:
    """One example mirrored along its rows and its columns where bool[2] says so."""

    def flip(image: Array) -> Array:
        for axis in (0, 1):
            image = jnp.where(flips[axis], jnp.flip(image, axis), image)
        return image

    size = jnp.array([WIDTH, HEIGHT], jnp.float32)
    center = jnp.where(flips[::-1], size - example.center, example.center)
    images = {name: flip(getattr(example, name)) for name in ("rgb", "depth", "height", "label")}
    return example.replace(center=center, **images)


def _recolour(example: SegmentExample, key: Array) -> SegmentExample:
    """One example; by half of the keys its background has another colour and contrast, its pattern stays."""
    coin_key, colour_key, contrast_key = jax.random.split(key, 3)
    light = example.rgb / 255.0
    is_back = (example.label == BACKGROUND)[..., None]
    mean = (light * is_back).sum((0, 1)) / jnp.maximum(is_back.sum(), 1)
    colour = jax.random.uniform(colour_key, (3,), minval=0.1, maxval=0.9)
    contrast = jax.random.uniform(contrast_key, (3,), minval=0.5, maxval=1.5)
    other = jnp.clip(colour + contrast * (light - mean), 0, 1)
    is_other = is_back & jax.random.bernoulli(coin_key)
    return example.replace(rgb=255 * jnp.where(is_other, other, light))


def shrink(rgb: np.ndarray, depth: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, ...]:
    """Images of any size as the network reads them: u8[120, 160, 3], and f16[120, 160] twice.

    Args:
      depth, height: f32[H, W], metres, nan where nothing was measured.
    """
    rows, columns = _sample_pixels(depth.shape)
    at = np.ix_(rows, columns)
    stacked = np.stack([depth, height])[:, rows][:, :, columns]
    stacked = np.where(np.isfinite(stacked), stacked, NO_DEPTH).astype(np.float16)
    factor = depth.shape[0] // HEIGHT
    if depth.shape == (factor * HEIGHT, factor * WIDTH):
        small = rgb.reshape(HEIGHT, factor, WIDTH, factor, 3).mean((1, 3))
        return np.round(small).astype(np.uint8), stacked[0], stacked[1]
    return rgb[at], stacked[0], stacked[1]


def shrink_label(label: np.ndarray) -> np.ndarray:
    """u8[120, 160]: labels of any size, each pixel that whose depth the network reads."""
    return label[np.ix_(*_sample_pixels(label.shape))]


def _sample_pixels(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The rows and columns of a picture that stand for the network's."""
    rows = ((np.arange(HEIGHT) + 0.5) * shape[0] / HEIGHT).astype(int)
    columns = ((np.arange(WIDTH) + 0.5) * shape[1] / WIDTH).astype(int)
    return rows, columns
