"""What a sampler is given, looked at before anything is compiled: types, shapes, numbers that are known."""

from __future__ import annotations

import inspect
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.assets.support_map import top_bounds_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import KeepOut, Region, Start
from cluttergen_jax.types import Array

_ROUNDING = 1e-5
"""Metres, for float32."""


def is_known(*arrays: Any) -> bool:
    """Whether all these are numbers, not tracers."""
    return not any(isinstance(each, jax.core.Tracer) for each in arrays)


def check_key(key: Any, call: str = "sample") -> None:
    """Refuses what is not one PRNG key, old style or new."""
    dtype = getattr(key, "dtype", None)
    shape = np.shape(key)
    if dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key):
        is_one = shape == ()
    else:
        # How long such a key is, JAX's default implementation says.
        is_one = (
            dtype == jnp.uint32 and shape == jax.eval_shape(lambda: jax.random.PRNGKey(0)).shape
        )
    if not is_one:
        raise ConfigError(
            f"{call}(key) with a {type(key).__name__} of type {dtype} and shape {shape}",
            "one key, as jax.random.key(0)",
            f"jax.vmap({call})(jax.random.split(jax.random.key(0), 256)) for many scenes"
            if call not in ("reshelve", "scene")
            else "one of several, as keys[0]",
        )


def check_call(region: Any, keep_out: Any, start: Any) -> None:
    """Refuses arguments of a call that are of another type or shape, and boxes that are not finite."""
    kinds = {"region": (region, Region), "keep_out": (keep_out, KeepOut), "start": (start, Start)}
    for name, (value, kind) in kinds.items():
        if value is not None and not isinstance(value, kind):
            raise ConfigError(
                f"sample({name}=...) with a {type(value).__name__}",
                f"a {kind.__name__}, whose arrays may be traced",
                f"make_sampler({name}=...) for one that stays the same",
            )
    if keep_out is not None:
        _check_boxes(keep_out)


def _check_boxes(boxes: KeepOut) -> None:
    arrays = (boxes.center, boxes.half_extents, boxes.yaw)
    shapes = tuple(jnp.shape(each) for each in arrays)
    number = shapes[0][:1]
    if len(number) != 1 or shapes != ((*number, 2), (*number, 2), number):
        raise ConfigError(
            f"KeepOut of shapes {shapes}", "center [B, 2], half_extents [B, 2], yaw [B]"
        )
    if is_known(*arrays) and not all(np.isfinite(np.asarray(each)).all() for each in arrays):
        raise ConfigError("a KeepOut with numbers that are not finite", "metres and radians")


def region_fits(region: Region, usual: Region, support: SupportAsset) -> Array:
    """bool: the region lies on the support, and is no larger than the world was made for; known or not."""
    half = jnp.asarray(region.half_extents)
    place = region.T_world_region.wxyz_xyz
    fits = jnp.all((half > 0) & (half <= usual.half_extents + 1e-6)) & jnp.all(jnp.isfinite(place))
    fits &= _is_on_top(region, support)
    if is_known(fits) and not fits:
        raise ConfigError(
            f"a region of {2 * half[0]:g} x {2 * half[1]:g} m about ({place[4]:g}, {place[5]:g})",
            f"a place on support {support.name!r}, and sides up to those of the sampler's own, "
            f"{2 * usual.half_extents[0]:g} x {2 * usual.half_extents[1]:g} m, "
            "compared one by one along the region's own axes",
            "make_sampler(region=...) with the largest that will be asked for",
        )
    return fits


def _is_on_top(region: Region, support: SupportAsset) -> Array:
    """bool: all corners are within the support's reach (`assets.support_map`)."""
    signs = jnp.array([[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]])
    corners = jax.vmap(region.T_world_region.apply)(signs * jnp.append(region.half_extents, 0.0))
    if support.named:
        surface = support.chosen
        corners = (corners - jnp.array(surface.position)) @ jnp.array(
            surface.T_world_surface[:3, :3]
        )
    reach = top_bounds_of(support)
    local = corners[:, :2] @ reach.axes
    return jnp.all((local >= reach.lower - _ROUNDING) & (local <= reach.upper + _ROUNDING))


def start_fits(start: Start, most: int) -> Array:
    """bool: no more objects stand there than the sampler was made for; if their number is known, it is so."""
    number = start.is_placed.sum()
    fits = number <= most
    if is_known(fits) and not fits:
        raise ConfigError(
            f"a start of {number} objects",
            f"up to {most}, as the sampler was made",
            "make_sampler(start=...)",
        )
    return fits


T = TypeVar("T")


def required_recipe(recipe: partial[T] | None, maker: str) -> partial[T]:
    """The recipe, by which an object is made again when it is unpickled.

    Raises:
      TypeError: there is none: the object was not made by `maker`.
    """
    if recipe is None:
        raise TypeError(
            f"it holds an engine, so the call of {maker} is pickled; it was made or changed otherwise"
        )
    return recipe


def recipe_text(recipe: partial[Any] | None) -> str:
    """The arguments of the call in one line, those with the default left out; "" if there is none."""
    if recipe is None:
        return ""
    parameters = inspect.signature(recipe.func).parameters
    given = dict(zip(parameters, recipe.args, strict=False)) | recipe.keywords
    usual = {name: each.default for name, each in parameters.items()}
    other = {
        name: value for name, value in given.items() if name not in usual or usual[name] != value
    }
    return ", ".join(f"{name}={value!r}" for name, value in other.items())
