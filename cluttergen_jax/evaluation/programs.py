"""Compiled programs shared between worlds: a table of methods, pools and supports compiles each only once.

What a world knows (clouds, weights, sizes) is constant to JAX, so that every world would be compiled anew,
although most programs differ in those numbers alone. Here the constants are lifted out of the traced program
and handed in as arguments; two traces that read the same share one executable.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.host import host_function
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.physics.report import empty_settling, empty_standing
from cluttergen_jax.progress import interruptible
from cluttergen_jax.types import Array, Settling, Standing

_KEPT = 48
"""Executables; each takes a few hundred of the 65,530 mappings of memory that Linux grants a process."""


class Programs:
    """Compiles functions, those that differ in constants alone only once; the latest ones are kept."""

    def __init__(self) -> None:
        self._compiled: OrderedDict[str, tuple[Any, Callable[..., Any]]] = OrderedDict()
        self._switches: dict[tuple[int, StabilityConfig], Switch] = {}

    def __len__(self) -> int:
        """How many executables there are."""
        return len(self._compiled)

    def compile(self, function: Callable[..., Any], *args: Any) -> Callable[..., Any]:
        """`function` compiled for arguments shaped like `args`; it takes their like."""
        traced = jax.jit(function).trace(*args)
        closed = traced.jaxpr
        constants = [jnp.asarray(each) for each in closed.consts]
        structure = jax.tree.structure(traced.out_info)
        name = _fingerprint(closed, (args, constants))
        if name not in self._compiled:
            lowered = jax.jit(_with_constants(closed.jaxpr)).lower(constants, jax.tree.leaves(args))
            # The trace is kept, so that no two of its callbacks ever share an address.
            self._compiled[name] = (traced, interruptible(lowered.compile))
            if len(self._compiled) > _KEPT:
                self._compiled.popitem(last=False)
        self._compiled.move_to_end(name)
        run = self._compiled[name][1]
        return lambda *given: jax.tree.unflatten(structure, run(constants, jax.tree.leaves(given)))

    def switched(self, physics: Any) -> Any:
        """A stand-in for a native engine that programs of other worlds share; other engines as they are.

        It drives the engine given last: one world is at work at a time.
        """
        if not isinstance(physics, NativePhysics):
            return physics
        name = (physics.layout.num_objects, physics.config)
        if name not in self._switches:
            self._switches[name] = Switch(*name)
        self._switches[name].engine = physics
        return self._switches[name]


class Switch:
    """`physics.protocol.Physics` that hands its calls to whichever native engine is set.

    Attributes:
      config: when an object stands still, the same for all engines.
      engine: the one at work.
    """

    engine: NativePhysics

    def __init__(self, num_objects: int, config: StabilityConfig) -> None:
        self.config = config
        self._settle = host_function(
            lambda *args: self.engine.settle_batch(*args),
            jax.eval_shape(lambda: empty_settling(jnp, (), num_objects, config)),
        )
        self._stand = host_function(
            lambda *args: self.engine.stand_batch(*args),
            jax.eval_shape(lambda: empty_standing(jnp, (), num_objects)),
        )

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """See `physics.protocol.Physics.settle`."""
        return self._settle(
            jnp.asarray(poses, jnp.float32),
            jnp.asarray(is_placed, bool),
            jnp.asarray(focus, jnp.int32),
            jnp.asarray(is_active, bool),
        )

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """See `physics.protocol.Physics.stand`."""
        return self._stand(
            jnp.asarray(poses, jnp.float32), jnp.asarray(is_placed, bool), jnp.asarray(is_active, bool)
        )


def _with_constants(jaxpr: Any) -> Callable[..., Any]:
    def run(constants: list[Array], leaves: list[Array]) -> Any:
        return jex.jaxpr_as_fun(jex.ClosedJaxpr(jaxpr, constants))(*leaves)

    return run


def _fingerprint(closed: Any, args: Any) -> str:
    """Equal for programs that do the same to their arguments and constants."""
    digest = hashlib.sha256(str(closed.jaxpr).encode())
    for leaf in jax.tree.leaves(args):
        digest.update(f"{jnp.shape(leaf)}{jnp.result_type(leaf)}".encode())
    for hidden in _hidden_arrays(closed.jaxpr):
        digest.update(f"{hidden.shape}{hidden.dtype}".encode() + hidden.tobytes())
    return digest.hexdigest()


def _hidden_arrays(jaxpr: Any) -> Iterator[np.ndarray]:
    """Arrays that a program's text does not spell out: constants of programs within it."""
    for equation in jaxpr.eqns:
        for value in jax.tree.leaves(equation.params, is_leaf=_is_program):
            if _is_program(value):
                for constant in getattr(value, "consts", ()):
                    yield np.asarray(constant)
                yield from _hidden_arrays(getattr(value, "jaxpr", value))
            elif isinstance(value, np.ndarray | jax.Array):
                yield np.asarray(value)


def _is_program(value: Any) -> bool:
    return isinstance(value, jex.ClosedJaxpr | jex.Jaxpr)
