"""The maker of pairs: draws scene, slot and camera, senses those alone, and has candidates judged."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa

from cluttergen_jax.assets import public_name
from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE
from cluttergen_jax.downstream.placer.map_from_depth import (
    QueryMaker,
    SceneCameras,
    depth_bytes,
    depth_of,
)
from cluttergen_jax.downstream.placer.map_search import draw, finalists, join, look
from cluttergen_jax.downstream.placer.pairs import (
    PAIRS,
    SCHEMA,
    PairSet,
    changed_frame,
    stack_queries,
)
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge
from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import Array
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics import Verdict
from cluttergen_jax.placement import (
    CLEARANCE,
    Episode,
    HeightMap,
    LowestFit,
    Rules,
    SearchConfig,
    draw_candidates,
)
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Bank, assets_section, front_matter, write_unless_own
from cluttergen_jax.sensing import FIRST_OBJECT, SUPPORT, Camera
from cluttergen_jax.tables import markdown_table

# Sources: a search on the true map, one on what the camera saw, and poses drawn uniformly.
TRUE_MAP = 0
PARTIAL_MAP = 1
RANDOM = 2

_NUM_TRUE = 12
_NUM_SEEN = 6
_NUM_CEILING = 6
_NUM_RANDOM_SEEN = 5
_NUM_RANDOM_CEILING = 3
_SEARCH = SearchConfig(num_candidates=192, num_finalists=6)
_NUM_UNIFORM = 24
_HIGHEST_COST = 0.5
"""Metres: candidates that cost so much or more are drawn a third as often as those that cost nothing."""

SOURCES = np.repeat(
    np.array([TRUE_MAP, PARTIAL_MAP, RANDOM], np.uint8),
    [_NUM_TRUE, _NUM_SEEN + _NUM_CEILING, _NUM_RANDOM_SEEN + _NUM_RANDOM_CEILING],
)
"""u8[32]: the source of each candidate of a pair."""


class CandidateDraw:
    """Draws the candidates of many pairs at once.

    Twelve are of a search on the true map and twelve of one on the partial maps, half of these as if what is
    hidden were free, half as if it were taken. A search draws among uniform poses that are lowered to first
    contact, and the finalists of many such, with chances that fall with the cost of `drop`: few of its best
    ever fail. Eight are uniform over region and turn, lowered onto a partial map. All are let go `CLEARANCE`
    above first contact.

    Args:
      rules: of the world.
    """

    def __init__(self, rules: Rules) -> None:
        # Nothing is simulated here: worlds of equal sizes share what is compiled.
        self._search = LowestFit(replace(rules, physics=None), _SEARCH)  # type: ignore[arg-type]

    def __call__(self, seeds: np.ndarray, episodes: Episode, queries: PlacementQuery) -> np.ndarray:
        """f32[Q, 32, 4]: x, y, z and yaw of T_region_object; seeds: u32[Q]."""
        keys = jax.vmap(new_key)(seeds)
        return np.asarray(_draw_many(self._search, keys, episodes, queries))


def _draw_candidates(true: LowestFit, key: Array, episode: Episode, query: PlacementQuery) -> Array:
    keys = jax.random.split(key, 4)
    parts = [
        _by_search(keys[0], true, episode),
        _by_map(keys[1], query, query.heights, _NUM_SEEN),
        _by_map(keys[2], query, query.ceilings, _NUM_CEILING),
        _random(keys[3], query),
    ]
    return jnp.concatenate(parts)


_draw_many: Any = jax.jit(jax.vmap(_draw_candidates, in_axes=(None, 0, 0, 0)))


def _by_search(key: Array, true: LowestFit, episode: Episode) -> Array:
    key_many, key_few, key_choice = jax.random.split(key, 3)
    scene = true.scene(episode)
    many = draw_candidates(key_many, episode.region, _SEARCH.num_candidates)
    few = draw_candidates(key_few, episode.region, _NUM_UNIFORM)
    found = true.closely(scene, join(true.best(scene, many, _SEARCH.num_finalists), few))
    height = found.scores.fit.rest + CLEARANCE
    pose = jnp.column_stack([found.candidates.xy, height, found.candidates.yaw])
    return pose[_choose(key_choice, found.cost, _NUM_TRUE)]


def _by_map(key: Array, query: PlacementQuery, heights: HeightMap, number: int) -> Array:
    key_many, key_few, key_choice = jax.random.split(key, 3)
    best = finalists(key_many, query, heights, _SEARCH)
    found = look(query, heights, join(best, draw(key_few, query, _NUM_UNIFORM)))
    return found.pose[_choose(key_choice, found.cost, number)]


def _random(key: Array, query: PlacementQuery) -> Array:
    candidates = draw(key, query, _NUM_RANDOM_SEEN + _NUM_RANDOM_CEILING)
    parts = (slice(0, _NUM_RANDOM_SEEN), slice(_NUM_RANDOM_SEEN, None))
    maps = (query.heights, query.ceilings)
    return jnp.concatenate(
        [
            look(query, heights, candidates.take(jnp.arange(len(candidates.yaw))[part])).pose
            for heights, part in zip(maps, parts, strict=True)
        ]
    )


def _choose(key: Array, cost: Array, number: int) -> Array:
    """i32[number]: a draw without repetition, the cheaper the likelier (Gumbel's trick)."""
    cost = jnp.clip(cost, 0.0, _HIGHEST_COST)
    noise = jax.random.gumbel(key, cost.shape)
    return jax.lax.top_k(noise - cost / _HIGHEST_COST, number)[1]


_SOURCES = {TRUE_MAP: "true map", PARTIAL_MAP: "partial map", RANDOM: "random"}
_COLUMNS = {
    "pair": "number in its split",
    "scene": "number of the scene in its bank",
    "slot": "which of the scene's objects is to be placed, in the order of placement",
    "object": "its name",
    "pool": "the pool that the scene was made of",
    "num_standing": "objects that stand already",
    "camera_K": "intrinsics, 3 x 3, row by row; a pixel's middle is at (column + .5, row + .5)",
    "T_region_camera": "the camera's pose, 4 x 4, row by row, metres; x right, y down, z forward",
    "width": "pixels",
    "height": "pixels",
    "depth": "u16, little-endian, row by row: millimetres of depth, 0 where nothing is, no noise",
    "labels": "u8, row by row: 0 the floor, 1 the support, 2 + k the k-th standing object",
    "standing": "names of the objects that stand, in the order of placement",
    "standing_poses": "T_region_object of each, metres and quaternion wxyz",
    "target_pose": "likewise, where the scene's own object rests",
    "candidate": "32 poses x, y, z and yaw of T_region_object at which the object is let go, metres, radians",
    "candidate_source": f"how each was found: {', '.join(f'{k} {v}' for k, v in _SOURCES.items())}",
    "candidate_verdict": "what became of it: "
    + ", ".join(f"{int(verdict)} {verdict.label}" for verdict in Verdict if verdict >= 0),
}

_ABOUT = (
    "Pairs for stable placement: what one depth camera sees of a partial scene, where the scene's next "
    "object rests, and 32 poses at which it was let go, with what became of each in physics. Scenes of "
    "different splits have different keys."
)
_FRAME = "The region frame has its origin at the middle of the queried region on the support's top, z up."


def write_card(pairs: PairSet) -> None:
    """Writes README.md, unless the user has one of their own there."""
    write_unless_own(pairs.path, lambda: card_text(pairs))


def card_text(pairs: PairSet) -> str:
    """The card as Markdown."""
    bank = Bank(pairs.path, {"assets": pairs.record["assets"]})
    assets = [bank.object(name) for name in sorted(pairs.record["assets"]["objects"])]
    files = [f"{{split: {split}, path: '{split}-*.parquet'}}" for split in pairs.splits]
    head = front_matter(
        [*(asset.provenance.licence for asset in assets), bank.support.provenance.licence],
        ["robotics", "simulation", "mujoco", "tabletop", "placement"],
        "stable placement pairs",
        f"[{', '.join(files)}]",
    )
    columns = markdown_table(
        ("column", "type", "meaning"),
        [(f"`{f.name}`", f"`{f.type}`", _COLUMNS[f.name]) for f in SCHEMA],
    )
    sections = [
        head,
        f"# {pairs.path.resolve().name}\n\n{_ABOUT}",
        *(_split(pairs, split) for split in pairs.splits),
        f"## Columns\n\n{columns}\n\n{_FRAME}",
        assets_section(assets, bank.support),
    ]
    return "\n\n".join(sections) + "\n"


def _split(pairs: PairSet, split: str) -> str:
    made = pairs.split(split)
    recipe: dict[str, Any] = made["recipe"]
    verdicts = np.concatenate(
        [np.array(rows["candidate_verdict"].to_pylist(), np.uint8) for rows in pairs.tables(split)]
    )
    shares = [(verdict.label, (verdicts == verdict).mean()) for verdict in Verdict if verdict >= 0]
    rows = {
        "pairs": made["num_pairs"],
        "scenes that stand in its bank": made["num_scenes"],
        "seed of the bank": f"{recipe.get('seed')} ({split}: from {SPLITS[split]} on)",
        "seed of the pairs": f"{made['seed']} (likewise)",
        "camera": made["camera"],
        "pool": public_name(str(recipe.get("pool"))),
        "method of the scenes": recipe.get("method"),
        "versions": ", ".join(f"{name} {number}" for name, number in made["versions"].items()),
        "verdicts of candidates": ", ".join(
            f"{name} {share:.1%}" for name, share in shares if share
        ),
    }
    return "\n".join(
        [f"## Split `{split}`", "", *(f"- {name}: {value}" for name, value in rows.items())]
    )


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
        for sensed in self._pool.map(
            self._look, pairs, places, *(each[:num_rows] for each in state)
        ):
            looks.append(sensed)
            on_rows(1)
        queries = [sensed.query for sensed in looks]
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
    """The pairs of one split in a folder, begun or continued; see `cluttergen_jax.placer.data`."""
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
                progress.say_compiling()
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
