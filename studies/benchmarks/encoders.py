"""What the scene encoders cost: a forward and a backward pass of the whole network, side by side.

python -m studies.benchmarks.encoders [--batch 32 256] [--full] [--write]
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.learning.agents import Agent
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.training.presets import paper
from studies.benchmarks.section import prose, report, table

_HISTORY = (5, 21)
"""Attempts, and the rows that are kept of each."""


@dataclass(frozen=True)
class Encoders:
    """Time the encoders.

    Attributes:
      pool: name or folder.
      batch: scenes in one pass.
      rounds: in which the encoders take turns.
      full: also the network of preset paper: 20,480 scene points and 1,024 of each object.
      write: renew this program's section of reports/benchmarks.md.
    """

    pool: str = "dining"
    batch: tuple[int, ...] = (16, 128)
    rounds: int = 5
    full: bool = False
    write: bool = False


class Contender:
    """One network at one batch size: its passes, compiled, and the time that they took.

    Attributes:
      num_weights: of the whole network.
      compile: seconds of the first calls.
      wall, cpu: seconds of each forward and of each backward pass.
    """

    def __init__(
        self, network: NetworkConfig, clouds: np.ndarray, half_extents: np.ndarray, batch: int
    ) -> None:
        agent = Agent(network, jnp.asarray(clouds), jnp.asarray(half_extents), len(clouds))
        seen = observations(batch, half_extents)
        params = agent.init(jax.random.key(0), jax.tree.map(lambda leaf: leaf[0], seen))
        self.num_weights = sum(leaf.size for leaf in jax.tree.leaves(params))
        kept = jax.jit(lambda params: agent.encode(params)(seen))(params)

        def loss(params: Any) -> Any:
            dist, value = agent.apply(params, kept)
            return jnp.sum(value**2) + jnp.sum(dist.log_prob(jnp.full((batch, 4), 0.4)))

        forward = jax.jit(lambda params: agent.apply(params, seen))
        backward = jax.jit(jax.grad(loss))
        self._passes: tuple[Callable[[], Any], ...] = (
            lambda: forward(params),
            lambda: backward(params),
        )
        self.wall: tuple[list[float], list[float]] = ([], [])
        self.cpu: tuple[list[float], list[float]] = ([], [])
        started = time.monotonic()
        for each in self._passes:
            jax.block_until_ready(each())
        self.compile = time.monotonic() - started

    def turn(self) -> None:
        """Each pass once."""
        for number, each in enumerate(self._passes):
            wall = time.monotonic()
            cpu = time.process_time()
            jax.block_until_ready(each())
            self.wall[number].append(time.monotonic() - wall)
            self.cpu[number].append(time.process_time() - cpu)


def observations(batch: int, half_extents: np.ndarray) -> dict[str, Any]:
    """Scenes with half of the objects standing anywhere on 0.60 x 0.70 m, turned anyhow about z."""
    rng = np.random.default_rng(0)
    objects = len(half_extents)
    place = rng.uniform(-0.28, 0.28, (batch, objects, 2))
    height = np.broadcast_to(half_extents[:, 2:], (batch, objects, 1))
    angle = rng.uniform(0, np.pi, (batch, objects, 1))
    nothing = np.zeros_like(angle)
    poses = np.concatenate([place, height, np.cos(angle), nothing, nothing, np.sin(angle)], -1)
    attempts, rows = _HISTORY
    return {
        "region": jnp.tile(jnp.array([0.3, 0.35, 0.3]), (batch, 1)),
        "focus": jnp.asarray(rng.integers(objects, size=batch)),
        "is_placed": jnp.asarray(rng.uniform(size=(batch, objects)) < 0.5),
        "T_region_object": jnp.asarray(poses, jnp.float32),
        "history": {
            "action": jnp.zeros((batch, attempts, 4)),
            "region": jnp.zeros((batch, attempts, 3)),
            "trajectory": jnp.zeros((batch, attempts, rows, 13)),
            "num_steps": jnp.zeros((batch, attempts), jnp.int32),
            "is_tried": jnp.zeros((batch, attempts), bool),
        },
    }


def networks(full: bool) -> dict[str, NetworkConfig]:
    """What is compared, by name."""
    chosen = {kind: NetworkConfig(scene_encoder=kind) for kind in ("set", "pointnet", "pointnet2")}
    if full:
        chosen["pointnet2, paper"] = paper().network
    frozen = {
        f"{name}, frozen": dataclasses.replace(network, encoder_frozen=True)
        for name, network in chosen.items()
        if network.reads_clouds
    }
    return chosen | frozen


def compete(args: Encoders) -> dict[tuple[str, int], Contender]:
    """All networks at all batch sizes, in turns."""
    objects = find_pool(args.pool).objects
    clouds = np.stack([each.cloud for each in objects])
    half_extents = np.abs(clouds).max(axis=1)
    contenders = {
        (name, batch): Contender(network, clouds, half_extents, batch)
        for batch in args.batch
        for name, network in networks(args.full).items()
    }
    for _ in range(args.rounds):
        for each in contenders.values():
            each.turn()
    return contenders


def body_of(contenders: dict[tuple[str, int], Contender], args: Encoders) -> str:
    """The section of reports/benchmarks.md."""
    rows = [
        [
            name,
            batch,
            f"{each.num_weights:,}",
            *(
                f"{1000 * np.median(seconds):,.1f}"
                for pair in (each.wall, each.cpu)
                for seconds in pair
            ),
            f"{each.compile:.0f}",
        ]
        for (name, batch), each in contenders.items()
    ]
    header = [
        "",
        "scenes",
        "weights",
        "forward: ms",
        "backward: ms",
        "forward: CPU ms",
        "backward: CPU ms",
    ]
    text = prose(
        f"""Scenes with half of the objects of {args.pool} placed; the whole network with actor, critic and
        history; medians of {args.rounds} rounds in which the networks take turns. Backward is a loss and its
        gradient. A frozen encoder's features were kept when the observation was made, so that its backward
        pass does not run it. Sizes: {_sizes(args.full)}."""
    )
    return f"## Encoders\n\n{text}\n\n{table([*header, 'compiling: s'], rows)}"


def _sizes(full: bool) -> str:
    return "; ".join(
        f"{name} {each.scene_points:,} points of the scene and {each.object_points:,} of an object, "
        f"{each.scene_features} features"
        for name, each in networks(full).items()
        if each.reads_clouds and not each.encoder_frozen
    )


def main(args: Encoders) -> None:
    """Prints the section, and with `write` puts it into reports/benchmarks.md."""
    report("encoders", body_of(compete(args), args), write=args.write, packages=("jax", "flax"))


if __name__ == "__main__":
    main(tyro.cli(Encoders))
