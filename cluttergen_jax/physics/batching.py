"""Gives a function of a batch of scenes the face of one scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from cluttergen_jax.types import Array

BatchFunction = Callable[..., Any]


def one_scene(batched: BatchFunction) -> BatchFunction:
    """A function of one scene that runs `batched`, whose arguments and results have a leading scene axis.

    `vmap` makes it one call of `batched`, and `vmap` of `vmap` one call with the axes flattened into one.
    MJX cannot be mapped from outside: its loop has to see the whole batch at once, to know when every scene
    is decided, and Warp shares one contact list among all scenes.
    """

    # The model's arrays have to stay inside. Without this `jit` they become arguments of `many`, a mapped
    # `cond` gives every argument the scene axis, and `custom_vmap` refuses constants that have one.
    enclosed = jax.jit(batched)

    @custom_vmap
    def many(*args: Array) -> Any:
        return enclosed(*args)

    @many.def_vmap
    def many_more(axis_size: int, is_batched: list[bool], *args: Array) -> tuple[Any, Any]:
        args = _broadcast(axis_size, is_batched, args)
        inner = args[0].shape[1]
        flat = many(*(arg.reshape(axis_size * inner, *arg.shape[2:]) for arg in args))
        result = jax.tree.map(lambda array: array.reshape(axis_size, inner, *array.shape[1:]), flat)
        return result, jax.tree.map(lambda _: True, result)

    @custom_vmap
    def one(*args: Array) -> Any:
        return jax.tree.map(lambda array: array[0], many(*(arg[None] for arg in args)))

    @one.def_vmap
    def one_mapped(axis_size: int, is_batched: list[bool], *args: Array) -> tuple[Any, Any]:
        result = many(*_broadcast(axis_size, is_batched, args))
        return result, jax.tree.map(lambda _: True, result)

    return one


def _broadcast(axis_size: int, is_batched: list[bool], args: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(
        arg if has_axis else jnp.broadcast_to(arg, (axis_size, *arg.shape))
        for arg, has_axis in zip(args, is_batched, strict=True)
    )
