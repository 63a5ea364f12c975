"""The physics interface, all that the decision process knows of a simulator, and engines behind it.

Engines take whole batches; those on the host get NumPy arrays.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.experimental.buffer_callback import buffer_callback

from cluttergen_jax.config import StabilityConfig, Together
from cluttergen_jax.geometry import rotate
from cluttergen_jax.progress import COMPILING
from cluttergen_jax.types import Array, Closing, Piling, Settling, Standing, Verdict


class Physics(Protocol):
    """Releases objects at rest and reports how they settle: SI units, world frame, one scene.

    Both functions are pure and may be called under `jit`, `vmap` (of `vmap`), `cond`, `while_loop` and
    `scan`. Index k is object k of the compiled world. An inactive scene costs nothing and returns its input.

    Attributes:
      config: when an object stands still.
      compiling: what to say before its programs are compiled.
    """

    config: StabilityConfig
    compiling: str

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """One attempt: lets go of the focus object among the placed ones.

        Args:
          poses: f32[K, 7], position and quaternion wxyz of every object; read where placed.
          is_placed: bool[K], the focus object included. The others are taken to lie at rest, as committed
            objects do: an engine may let them sleep until they are touched.
          focus: i32, the current object.
          is_active: bool.
        """
        ...

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """The last check of a finished scene, everything awake (docs/contract.md: staged)."""
        ...


SUMS = ("motion_sum", "speed_sum", "shift", "turn")
"""Of a `stability.Track`, what a `Settling` tells as it is, where the scene has not diverged."""


def _zeros(xp: Any, batch: tuple[int, ...]) -> Callable[..., Any]:
    """Makes zeros of a type and of some axes behind those of a batch."""
    return lambda kind, *shape: xp.zeros((*batch, *shape), dtype=kind)


def _not_judged(xp: Any, batch: tuple[int, ...]) -> Any:
    return xp.full(batch, int(Verdict.NONE), dtype=xp.int32)


def empty_settling(
    xp: Any, batch: tuple[int, ...], num_objects: int, config: StabilityConfig
) -> Settling:
    """The report of scenes that were not judged: verdict NONE, everything else zero."""
    zeros = _zeros(xp, batch)
    return Settling(
        verdict=_not_judged(xp, batch),
        num_steps=zeros(xp.int32),
        check_steps=zeros(xp.int32),
        poses=zeros(xp.float32, num_objects, 7),
        trajectory=zeros(xp.float32, config.last_step + 1, 13),
        motion_sum=zeros(xp.float32),
        speed_sum=zeros(xp.float32),
        shift=zeros(xp.float32, num_objects),
        turn=zeros(xp.float32, num_objects),
        penetration=zeros(xp.float32),
        is_quiet=zeros(xp.bool),
        margin=zeros(xp.float32, num_objects),
        touches=zeros(xp.bool, num_objects),
        bears=zeros(xp.bool, num_objects),
    )


def empty_standing(xp: Any, batch: tuple[int, ...], num_objects: int) -> Standing:
    """The report of scenes whose last check was not run: verdict NONE, everything else zero."""
    zeros = _zeros(xp, batch)
    return Standing(
        verdict=_not_judged(xp, batch),
        num_steps=zeros(xp.int32),
        shift=zeros(xp.float32, num_objects),
        turn=zeros(xp.float32, num_objects),
    )


def empty_closing(xp: Any, batch: tuple[int, ...], num_objects: int, num_doors: int) -> Closing:
    """`empty_standing` where doors are closed: no door, no object."""
    zeros = _zeros(xp, batch)
    standing = empty_standing(xp, batch, num_objects)
    return Closing(
        verdict=standing.verdict,
        num_steps=standing.num_steps,
        shift=standing.shift,
        turn=standing.turn,
        poses=zeros(xp.float32, num_objects, 7),
        travel=zeros(xp.float32, num_doors),
        door=_not_judged(xp, batch),
        hit=_not_judged(xp, batch),
    )


def empty_piling(xp: Any, batch: tuple[int, ...], num_objects: int) -> Piling:
    """The report of scenes that were not piled: verdict NONE, everything else zero."""
    zeros = _zeros(xp, batch)
    return Piling(
        verdict=_not_judged(xp, batch),
        num_steps=zeros(xp.int32),
        check_steps=zeros(xp.int32),
        poses=zeros(xp.float32, num_objects, 7),
        releases=zeros(xp.int32, num_objects),
        steps=zeros(xp.int32, num_objects),
        drift=zeros(xp.float32),
        penetration=zeros(xp.float32),
        touches=zeros(xp.bool, num_objects, num_objects),
        level=zeros(xp.int32, num_objects),
        num_beside=zeros(xp.int32),
        num_leaning=zeros(xp.int32),
        is_left_out=zeros(xp.bool, num_objects),
        margin=zeros(xp.float32, num_objects),
        rejected=zeros(xp.int32, int(Verdict.BLOCKED) + 1),
    )


@lru_cache(maxsize=64)
def _report_shapes(
    num_objects: int, config: StabilityConfig, num_doors: int
) -> tuple[Any, Any, Any]:
    """The reports of `settle`, `stand` and `pile` with the shape of each field in its place."""

    def check() -> Standing:
        if num_doors:
            return empty_closing(jnp, (), num_objects, num_doors)
        return empty_standing(jnp, (), num_objects)

    return (
        jax.eval_shape(lambda: empty_settling(jnp, (), num_objects, config)),
        jax.eval_shape(check),
        jax.eval_shape(lambda: empty_piling(jnp, (), num_objects)),
    )


def below_top(xp: Any, poses: Array, center_of_mass: Array, top: float) -> Array:
    """Whether each object's centre of mass is below the support's top.

    Args:
      poses: f[..., K, 7]; center_of_mass: f[K, 3], object frames, metres; top: metres.

    Returns:
      bool[..., K].
    """
    center = rotate(xp, poses[..., 3:], xp.broadcast_to(center_of_mass, (*poses.shape[:-1], 3)))
    return poses[..., 2] + center[..., 2] < top


def where(xp: Any, condition: Array, yes: Array, no: Array) -> Array:
    """`xp.where` scene by scene: a condition bool[N], arrays f[N, ...]."""
    return xp.where(condition.reshape(condition.shape + (1,) * (yes.ndim - 1)), yes, no)


def mask_scenes(xp: Any, array: Array, is_kept: Array) -> Array:
    """`array`, f[N, ...], with zeros for scenes that are not kept: a diverged scene reports no motion."""
    return where(xp, is_kept, array, xp.zeros_like(array))


HostFunction = Callable[..., Any]


class OneScenePhysics:
    """`Physics` on functions of one scene: arguments may be of whatever type fits.

    Args:
      config: when an object stands still.
      settle_one, stand_one: take arrays of the types that the interface names.
    """

    compiling = COMPILING
    """What to say before its programs are compiled."""

    def __init__(
        self, config: StabilityConfig, settle_one: HostFunction, stand_one: HostFunction
    ) -> None:
        self.config = config
        self._settle_one = settle_one
        self._stand_one = stand_one

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """See `Physics.settle`."""
        return self._settle_one(
            jnp.asarray(poses, jnp.float32),
            jnp.asarray(is_placed, bool),
            jnp.asarray(focus, jnp.int32),
            jnp.asarray(is_active, bool),
        )

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """See `Physics.stand`."""
        return self._stand_one(
            jnp.asarray(poses, jnp.float32),
            jnp.asarray(is_placed, bool),
            jnp.asarray(is_active, bool),
        )


class BatchEngine(Protocol):
    """An engine on the host: N scenes held in NumPy arrays with one leading axis."""

    config: StabilityConfig

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        """`Physics.settle` for each of them."""
        ...

    def stand_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray
    ) -> Standing:
        """`Physics.stand` for each of them."""
        ...

    def make_batch(self, how: Together, *arrays: np.ndarray) -> Piling:
        """`HostPhysics.make` for each of them."""
        ...

    def free(self) -> None:
        """Gives back what it holds for its next batches; they are only slower to begin."""
        ...


class HostPhysics(OneScenePhysics):
    """`Physics` by the methods of a `BatchEngine`, which subclasses have.

    Args:
      num_objects: K; config: when an object stands still.
      num_doors: that are closed before the last check, whose report is a `Closing` then.
    """

    settle_batch: HostFunction
    stand_batch: HostFunction

    def __init__(self, num_objects: int, config: StabilityConfig, num_doors: int = 0) -> None:
        settling, standing, self._piling = _report_shapes(num_objects, config, num_doors)
        settle = host_function(self.settle_batch, settling)
        super().__init__(config, settle, host_function(self.stand_batch, standing))

    def make(self, how: Together, *asked: Array) -> Piling:
        """One scene that is made as a whole.

        Args:
          how: which of the makers.
          asked: the arrays of its request for one scene (`physics.piles.PileRequest`,
            `physics.crowds.CrowdRequest`, `physics.drops.DropRequest`), and bool, whether it is active.
        """
        return host_function(partial(self.make_batch, how), self._piling)(*asked)

    def make_batch(self, how: Together, *arrays: np.ndarray) -> Piling:
        """`make` for N scenes held in NumPy arrays with one leading axis."""
        raise NotImplementedError(f"{type(self).__name__} makes no whole scenes ({how})")


class NumberedEngines:
    """Engines of worlds of one size, each known by a number; the one that was asked last is at hand.

    What is compiled around `with_number` serves all of them: the number may be traced.

    Args:
      num_objects: K of every world; config: when an object stands still.
      make: the engine of a number; None where each is handed in (`put`).
      num_doors: of every world, see `HostPhysics`.
    """

    def __init__(
        self,
        num_objects: int,
        config: StabilityConfig,
        make: Callable[[int], BatchEngine] | None = None,
        num_doors: int = 0,
    ) -> None:
        self.config = config
        self._make = make
        self._lock = threading.RLock()
        self._at_hand: tuple[int, BatchEngine] | None = None
        settling, standing, piling = _report_shapes(num_objects, config, num_doors)
        self.settle_one = host_function(partial(self._batch, "settle_batch"), settling)
        self.stand_one = host_function(partial(self._batch, "stand_batch"), standing)
        self._piling = piling

    def with_number(self, number: Array) -> HostPhysics:
        """The physics of the world of a number, i32."""
        return _Numbered(self, number)

    def make_one(self, how: Together, number: Array, *asked: Array) -> Piling:
        """`HostPhysics.make` in the world of a number."""

        def make(number: np.ndarray, *arrays: np.ndarray) -> Piling:
            return self._batch("make_batch", number, *arrays, first=(how,))

        return host_function(make, self._piling)(number, *asked)

    def engine(self, number: int) -> BatchEngine:
        """The engine of a number; what the one before held is given back."""
        with self._lock:
            if self._at_hand is None or self._at_hand[0] != number:
                assert self._make is not None, f"no engine {number} was put here"
                self._free()
                self._at_hand = number, self._make(number)
            return self._at_hand[1]

    def put(self, engine: BatchEngine, number: int = 0) -> None:
        """From now on `engine` is that of a number; what the one before held is given back."""
        with self._lock:
            self._free()
            self._at_hand = number, engine

    def _free(self) -> None:
        if self._at_hand is not None:
            self._at_hand[1].free()

    def _batch(
        self, what: str, number: np.ndarray, *arrays: np.ndarray, first: tuple[Any, ...] = ()
    ) -> Any:
        """One call for each number among N scenes; `first` are arguments before the arrays."""
        numbers = np.unique(number)
        with self._lock:
            if len(numbers) == 1:
                return getattr(self.engine(int(numbers[0])), what)(*first, *arrays)
            rows = [np.flatnonzero(number == each) for each in numbers]
            parts = []
            for each, at in zip(numbers, rows, strict=True):
                run = getattr(self.engine(int(each)), what)
                parts.append(run(*first, *(array[at] for array in arrays)))
        order = np.argsort(np.concatenate(rows))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *parts)


class _Numbered(HostPhysics):
    """`Physics` of one number."""

    def __init__(self, engines: NumberedEngines, number: Array) -> None:
        self._engines = engines
        self._number = number
        settle = partial(engines.settle_one, number)
        OneScenePhysics.__init__(self, engines.config, settle, partial(engines.stand_one, number))

    def make(self, how: Together, *asked: Array) -> Piling:
        """See `HostPhysics`."""
        return self._engines.make_one(how, self._number, *asked)

    def make_batch(self, how: Together, *arrays: np.ndarray) -> Piling:
        """See `BatchEngine`."""
        return self._engines.engine(int(self._number)).make_batch(how, *arrays)

    def settle_batch(self, *arrays: np.ndarray) -> Settling:
        """See `BatchEngine`."""
        return self._engines.engine(int(self._number)).settle_batch(*arrays)

    def stand_batch(self, *arrays: np.ndarray) -> Standing:
        """See `BatchEngine`."""
        return self._engines.engine(int(self._number)).stand_batch(*arrays)


def host_function(function: HostFunction, shapes: Any) -> HostFunction:
    """`function` as a pure JAX function of one scene that may be mapped any number of times.

    On a CPU it works on XLA's own buffers. `jax.pure_callback` would make JAX arrays of its arguments first,
    and the copy of a large one waits for a thread of XLA's pool, whose threads may all be waiting in
    callbacks: with two cores and a few independent callbacks that hung within seconds. From a GPU the
    arguments arrive as host memory, and no thread of that pool is held.

    Args:
      function: takes N scenes as NumPy arrays with one leading axis, which it may not keep, and returns
        `shapes` with that axis. Its last argument has no axes of its own.
      shapes: the result for one scene, a pytree of `jax.ShapeDtypeStruct`.
    """
    batched = _flatten_axes(function)

    def write(context: Any, out: Any, *buffers: Any) -> None:
        del context
        results = batched(*(np.asarray(buffer) for buffer in buffers))
        for buffer, result in zip(jax.tree.leaves(out), jax.tree.leaves(results), strict=True):
            np.asarray(buffer)[...] = result

    on_buffers = buffer_callback(write, shapes, vmap_method="broadcast_all")

    def call(*args: Array) -> Any:
        if jax.default_backend() == "cpu":
            return on_buffers(*args)
        return jax.pure_callback(batched, shapes, *args, vmap_method="broadcast_all")

    return call


def _flatten_axes(function: HostFunction) -> HostFunction:
    """`function` for any number of leading axes, none included."""

    def call(*args: Array) -> Any:
        arrays = [np.asarray(array) for array in args]
        batch = arrays[-1].shape
        num_scenes = int(np.prod(batch))
        flat = [array.reshape((num_scenes, *array.shape[len(batch) :])) for array in arrays]
        result = function(*flat)
        return jax.tree.map(lambda array: array.reshape((*batch, *array.shape[1:])), result)

    return call


def one_scene(batched: HostFunction) -> HostFunction:
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


def _broadcast(
    axis_size: int, is_batched: list[bool], args: tuple[Array, ...]
) -> tuple[Array, ...]:
    return tuple(
        arg if has_axis else jnp.broadcast_to(arg, (axis_size, *arg.shape))
        for arg, has_axis in zip(args, is_batched, strict=True)
    )
