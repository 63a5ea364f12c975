"""Where the environments of one learner live: on one device, or spread over several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

AXIS = "envs"


class Devices(Protocol):
    """What the learner asks of the devices that it runs on."""

    def each(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function` of one environment for all of them, along the leading axis of its arguments."""
        ...

    def spread(self, tree: Any) -> Any:
        """The same values, divided among the devices along the leading axis."""
        ...


@dataclass(frozen=True)
class OneDevice:
    """Everything in one place."""

    def each(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """See `Devices.each`."""
        return jax.vmap(function)

    def spread(self, tree: Any) -> Any:
        """See `Devices.spread`."""
        return tree


@dataclass(frozen=True)
class ManyDevices:
    """Environments divided evenly over devices, weights on all of them.

    The compiler divides what is between the steps of the environments, and its result is that of one device
    up to rounding. The steps themselves may call the host, which no compiler can divide: they are mapped.

    Attributes:
      mesh: one axis, `AXIS`.
    """

    mesh: Mesh

    @staticmethod
    def of(devices: list[Any]) -> ManyDevices:
        """All of `devices`, in their order."""
        return ManyDevices(Mesh(np.array(devices), (AXIS,), axis_types=(AxisType.Auto,)))

    def each(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """See `Devices.each`."""
        shared = PartitionSpec(AXIS)
        return jax.shard_map(
            jax.vmap(function), mesh=self.mesh, in_specs=shared, out_specs=shared, check_vma=False
        )

    def spread(self, tree: Any) -> Any:
        """See `Devices.spread`."""
        return jax.lax.with_sharding_constraint(tree, self.divided)

    @property
    def divided(self) -> NamedSharding:
        """Of arrays whose leading axis is the environments'."""
        return NamedSharding(self.mesh, PartitionSpec(AXIS))

    @property
    def everywhere(self) -> NamedSharding:
        """Of arrays that every device holds whole."""
        return NamedSharding(self.mesh, PartitionSpec())
