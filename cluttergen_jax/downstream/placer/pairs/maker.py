"""The maker of pairs: draws scene, slot and camera, senses those alone, and has candidates judged."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.pairs.candidate_draw import SOURCES, CandidateDraw
from cluttergen_jax.downstream.placer.pairs.card import write_card
from cluttergen_jax.downstream.placer.pairs.store import (
    PAIRS,
    SCHEMA,
    PairSet,
    changed_frame,
    stack_queries,
)
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge
from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.downstream.placer.scene_cameras import SceneCameras, depth_bytes, depth_of
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import Episode
from cluttergen_jax.progress import COMPILING, Progress
from cluttergen_jax.scene import Bank
from cluttergen_jax.sensing import FIRST_OBJECT, SUPPORT, Camera


class SensedPair(NamedTuple):
    """One pair as it was sensed: camera, bytes of `pairs.SCHEMA`, and the query."""

    camera: Camera
    depth: bytes
    labels: bytes
    query: PlacementQuery


class PairMaker:
    """Makes pairs of the scenes of a bank; pair i is the same however many are made.

    Args:
      scenes: of the bank.
      camera: a preset's name; seed: of all that is drawn; num_threads: 0 takes every core.

    Raises:
      ConfigError: there is no such camera.
    """

    def __init__(self, scenes: PartialScenes, camera: str, seed: int, num_threads: int = 0) -> None:
        self.scenes = scenes
        self.seed = seed
        self._cameras = SceneCameras(scenes.problem, camera)
        self._maker = QueryMaker(scenes.problem)
        self._judge = ProposalJudge(scenes.rules)
        self._draw = CandidateDraw(scenes.rules)
        self._pool = ThreadPoolExecutor(num_threads or os.cpu_count())

    def places(self, pairs: np.ndarray) -> np.ndarray:
        """i64[P, 2]: scene and slot of each pair; all of a bank come before any comes again."""
        known = self.scenes.places()
        rounds, rest = np.divmod(pairs, len(known))
        order = {
            number: np.random.default_rng((self.seed, number)).permutation(len(known))
            for number in np.unique(rounds)
        }
        return np.array(
            [known[order[number][place]] for number, place in zip(rounds, rest, strict=True)]
        )

    def block(
        self, block: int, num_rows: int, on_rows: Callable[[int], None] = lambda number: None
    ) -> pa.Table:
        """The first rows of a block; told of each pair that is sensed."""
        pairs = block * PAIRS.block_size + np.arange(num_rows)
        places = self.places(pairs)
        # Programs are made for whole blocks.
        whole = places[np.minimum(np.arange(PAIRS.block_size), num_rows - 1)]
        episodes = self.scenes.episodes(whole)
        looks = []
        state = (np.asarray(episodes.poses), np.asarray(episodes.is_placed))
        for look in self._pool.map(self._look, pairs, places, *(each[:num_rows] for each in state)):
            looks.append(look)
            on_rows(1)
        queries = [look.query for look in looks]
        queries += [queries[-1]] * (PAIRS.block_size - num_rows)
        candidates = self._candidates(block, episodes, stack_queries(queries))[:num_rows]
        scene = np.repeat(np.arange(num_rows), candidates.shape[1])
        judged = self._judge.settle(episodes, scene, candidates.reshape(-1, 4))
        verdict = judged.verdict.reshape(candidates.shape[:2])
        each = zip(pairs.tolist(), places, looks, candidates, verdict, strict=True)
        rows = [self._row(*one) for one in each]
        return pa.Table.from_pylist(rows, schema=SCHEMA)

    def _candidates(self, block: int, episodes: Episode, queries: PlacementQuery) -> np.ndarray:
        rng = np.random.default_rng((self.seed, block, 1))
        return self._draw(
            rng.integers(2**32, size=PAIRS.block_size, dtype=np.uint32), episodes, queries
        )

    def _look(
        self, pair: int, place: np.ndarray, poses: np.ndarray, is_placed: np.ndarray
    ) -> SensedPair:
        """What the pair's camera sees."""
        rng = np.random.default_rng((self.seed, pair, 2))
        camera, image = self._cameras.look(poses, is_placed, rng)
        stored = depth_bytes(image.depth)
        depth = depth_of(stored, camera.width, camera.height)
        # A placer that is given noisy maps proposes poses that fit them, so every other pair has such.
        sight = self._maker.see(depth, camera, REALSENSE if pair % 2 else NOISE_OFF, rng)
        scene, slot = place
        order = self.scenes.object_index[scene]
        return SensedPair(
            camera,
            stored,
            _labels(image.label, order[:slot]),
            self._maker.query(sight, int(order[slot])),
        )

    def _row(
        self,
        pair: int,
        place: np.ndarray,
        look: SensedPair,
        candidates: np.ndarray,
        verdict: np.ndarray,
    ) -> dict[str, object]:
        scene, slot = place
        T_region_world = np.linalg.inv(self._maker.T_world_region)
        names = self.scenes.problem.world.names
        camera = look.camera
        order = self.scenes.object_index[scene]
        poses = changed_frame(T_region_world, self.scenes.poses[scene])
        return {
            "pair": pair,
            "scene": int(self.scenes.number[scene]),
            "slot": int(slot),
            "object": names[order[slot]],
            "pool": str(self.scenes.problem.config.pool),
            "num_standing": int(slot),
            "camera_K": camera.K.ravel().tolist(),
            "T_region_camera": (T_region_world @ camera.T_world_camera).ravel().tolist(),
            "width": camera.width,
            "height": camera.height,
            "depth": look.depth,
            "labels": look.labels,
            "standing": [names[index] for index in order[:slot]],
            "standing_poses": poses[:slot].tolist(),
            "target_pose": poses[slot].tolist(),
            "candidate": candidates.tolist(),
            "candidate_source": SOURCES.tolist(),
            "candidate_verdict": verdict.tolist(),
        }


def write_pairs(
    out: str | Path,
    bank: Bank,
    split: str,
    num_pairs: int | None,
    camera: str,
    seed: int,
    num_threads: int = 0,
    overwrite: bool = False,
) -> PairSet:
    """The pairs of one split in a folder, begun or continued; see `cluttergen_jax.placer_data`."""
    path = Path(out)
    scenes = PartialScenes(bank, num_threads)
    num_pairs = scenes.num_queries if num_pairs is None else num_pairs
    # Pair i of one split has nothing in common with pair i of another.
    seed = SPLITS[split] + seed
    maker = PairMaker(scenes, camera, seed, num_threads)
    made = {
        "seed": seed,
        "camera": camera,
        "block_size": PAIRS.block_size,
        "num_scenes": len(scenes.number),
        "recipe": bank.record["recipe"],
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax")},
    }

    def fill(record: dict[str, Any], missing: dict[int, int]) -> None:
        total = record["splits"][split][PAIRS.number]
        with Progress(
            f"pairs of {split}", total, "pair", total - sum(missing.values())
        ) as progress:
            if missing:
                progress.say(COMPILING)
            for block, rows in missing.items():
                PAIRS.write_block(path, split, block, maker.block(block, rows, progress.update))
            progress.update(0, f"{progress.rate():.1f} pairs/s")
        write_card(PairSet(path, record))

    shared = {"assets": bank.record.get("assets")}
    return PairSet(path, PAIRS.write(path, bank, shared, split, made, num_pairs, overwrite, fill))


def split_of(bank: Bank, asked: str | None) -> str:
    """The split that a bank's scenes belong to, by its seed. Raises ConfigError: another one is asked for."""
    seed = int(bank.record["recipe"].get("seed", 0))
    split = max((name for name in SPLITS if SPLITS[name] <= seed), key=SPLITS.__getitem__)
    if asked not in (None, split):
        raise ConfigError(
            f"split = {asked!r} of {bank.path}, whose seed is {seed}",
            f"{split!r}: seeds from {', '.join(f'{first} ({name})' for name, first in SPLITS.items())}",
            f"split={split!r}, or a bank of that split",
        )
    return split


def _labels(label: np.ndarray, standing: Sequence[int]) -> bytes:
    """u8[H, W]: labels of the world's objects as those of the standing ones, in their order."""
    number = np.zeros(int(label.max(initial=FIRST_OBJECT)) + 1, np.uint8)
    number[SUPPORT] = SUPPORT
    for place, index in enumerate(standing):
        if FIRST_OBJECT + index < len(number):
            number[FIRST_OBJECT + index] = FIRST_OBJECT + place
    return number[label].tobytes()
