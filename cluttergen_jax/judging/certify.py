"""Stability certificates: how well a scene stands in plain numbers, and these as columns of a bank."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.config import DETECTORS, ContactConfig, StabilityConfig
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import writing
from cluttergen_jax.judging.scene_models import (
    SceneModels,
    StandingModel,
    TiltConfig,
    contacts_of,
    movement,
    robust,
    shake,
    tilt,
)
from cluttergen_jax.kept_folder import hold_folder
from cluttergen_jax.physics.standing import horizons_of
from cluttergen_jax.placement.world import base_name, make_world
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene.bank import (
    CERTIFICATE,
    Bank,
    BankIndex,
    StoredBlocks,
    check_is_here,
    is_certified,
    read_bank,
    schema_of,
    write_card,
)
from cluttergen_jax.statistics import finite

_RENAMED = {
    "drift": "horizon_drift",
    "drift_turn": "horizon_turn",
    "drift_seconds": "horizon_seconds",
}


@dataclass(frozen=True, eq=False)
class Certification:
    """What `cluttergen_jax.certify` did.

    Attributes:
      shake: f64[N], m/s^2, the shake scores of all scenes that stand.
      num_new: rows that were measured now.
    """

    shake: np.ndarray
    num_new: int


def certify_bank(
    bank: Bank, seconds: float, jobs: int, force: bool, cluster: Cluster | None = None
) -> Certification:
    """The certificates of a bank's scenes, written into it; see `cluttergen_jax.certify`."""
    horizons_of((seconds,))
    check_is_here(bank.path)
    with hold_folder(bank.path):
        # As it is now: another process may have written it since it was opened.
        bank = read_bank(bank.path)
        found = _certify(bank, seconds, jobs, force, cluster)
        with writing(bank.path):
            write_card(bank)
    return found


def _certify(
    bank: Bank, seconds: float, jobs: int, force: bool, cluster: Cluster | None
) -> Certification:
    index = BankIndex.of(bank)
    certifier = Certifier.of(bank, seconds, jobs)
    blocks = _Blocks(bank.blocks(), seconds, force)
    num_new = 0
    with Progress("certifying", bank.num_scenes, "scene", blocks.num_done) as progress:
        if cluster is None:
            certify = certifier()
            measured = ((place, certify(rows)) for place, rows in enumerate(blocks))
        else:
            measured = each_on(
                cluster, replace(certifier, jobs=jobs or 1), blocks, "block", jobs or 1
            )
        with closing(measured):
            for place, rows in measured:
                index.write_block(blocks.numbers[place], rows)
                num_new += rows.num_rows
                progress.update(rows.num_rows)
    index.merge_shards()
    scores = np.concatenate(
        [np.array(rows["shake"].drop_null()) for rows in bank.tables(["shake"])]
    )
    if not len(scores):
        raise BankError(f"{bank.path}: no scene in it stands", hint="more scenes")
    return Certification(scores, num_new)


class _Blocks(Sequence[pa.Table]):
    """The blocks of a bank that are to be measured over a horizon, each read when it is asked for.

    Attributes:
      numbers: which these are; num_done: scenes of the others.
    """

    def __init__(self, stored: StoredBlocks, seconds: float, force: bool) -> None:
        self._stored = stored
        self.num_done = 0
        self.numbers = list[int]()
        for number in stored.places:
            rows = stored.read_block(number)
            if force or not is_certified(rows, seconds):
                self.numbers.append(number)
            else:
                self.num_done += rows.num_rows

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, place: Any) -> Any:
        return self._stored.read_block(self.numbers[place])


@dataclass(frozen=True, eq=False)
class Certifier:
    """Makes what measures blocks, here or in another process: plain models of the bank's own assets.

    Attributes:
      objects: of the bank's world, in order; support, stability, contact: likewise. None where blocks drew
        objects of their own: then those of a block come from the bank at `path`.
      seconds, jobs: of `cluttergen_jax.certify`.
    """

    path: Path
    objects: tuple[ObjectAsset, ...] | None
    support: SupportAsset
    stability: StabilityConfig
    contact: ContactConfig
    seconds: float
    jobs: int

    @classmethod
    def of(cls, bank: Bank, seconds: float, jobs: int) -> Certifier:
        """What measures the blocks of a bank.

        Raises:
          BankError: the bank's record or an asset is damaged.
        """
        recipe = bank.record["recipe"]
        asset_of = lru_cache(maxsize=None)(bank.object)
        names = recipe.get("names")
        is_named = isinstance(names, list) and all(isinstance(name, str) for name in names)
        if not (names and is_named):
            raise BankError(f"{bank.path}: its record does not name the objects of its world")
        return cls(
            path=bank.path,
            objects=None
            if recipe.get("shelf")
            else tuple(asset_of(base_name(name)) for name in names),
            support=bank.support,
            stability=bank.stability,
            contact=bank.contact,
            seconds=seconds,
            jobs=jobs,
        )

    def __call__(self) -> Callable[[pa.Table], pa.Table]:
        """The function that is given a block and returns it with its certificate."""
        if self.objects is not None:
            models = self._models(self.objects)
            return partial(add_certificates, models=models, seconds=self.seconds, jobs=self.jobs)
        bank = read_bank(self.path)

        def certify_drawn(rows: pa.Table) -> pa.Table:
            used = np.unique(pc.list_flatten(rows["object_index"]).to_numpy())
            models = self._models([bank.object(bank.recipe["names"][number]) for number in used])
            return add_certificates(rows, models, self.seconds, self.jobs, used)

        return certify_drawn

    def _models(self, objects: Sequence[ObjectAsset]) -> SceneModels:
        world = make_world(objects, self.support, self.stability, self.contact)
        # As in the bank's files.
        stability = replace(self.stability, timestep=self.stability.file_timestep)
        return SceneModels(world, stability, self.contact)


def add_certificates(
    rows: pa.Table,
    models: SceneModels,
    seconds: float,
    jobs: int,
    numbers: np.ndarray | None = None,
) -> pa.Table:
    """The rows with the columns of `CERTIFICATE`.

    Args:
      numbers: i[K], of the models' objects in the rows, rising; 0 to K - 1 if None.
    """
    numbers = np.arange(models.world.num_objects) if numbers is None else numbers
    local = {int(number): place for place, number in enumerate(numbers)}
    rows = rows.select([name for name in schema_of(rows).names if name not in CERTIFICATE.names])
    scenes = rows.select(["is_success", "object_index", "is_placed", "poses"]).to_pylist()
    results: list[dict[str, Any]] = [dict.fromkeys(CERTIFICATE.names) for _ in scenes]
    good = [place for place, scene in enumerate(scenes) if scene["is_success"]]
    if good:
        poses, is_placed = _by_object([scenes[place] for place in good], local)
        found = certificates(models, poses, is_placed, seconds, num_threads=jobs)
        for place, each in zip(good, found, strict=True):
            margins = [each["margins"][local[k]] for k in scenes[place]["object_index"]]
            results[place] = {_RENAMED.get(name, name): value for name, value in each.items()}
            results[place]["margins"] = margins
            results[place]["rests_on"] = [
                (int(numbers[i]), -1 if j < 0 else int(numbers[j])) for i, j in each["rests_on"]
            ]
    extra = pa.Table.from_pylist(results, schema=CERTIFICATE)
    for field in CERTIFICATE:
        rows = rows.append_column(field, extra[field.name])
    return rows


def _by_object(
    scenes: list[dict[str, Any]], local: dict[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """f64[N, K, 7] and bool[N, K] of rows whose slots may be of different numbers.

    Args:
      local: the number of an object in the models, by its number in the rows.
    """
    placed = np.zeros((len(scenes), len(local)), bool)
    poses = np.tile(np.eye(7)[3], (*placed.shape, 1))
    for row, scene in enumerate(scenes):
        for number, is_there, pose in zip(
            scene["object_index"], scene["is_placed"], scene["poses"], strict=True
        ):
            if number not in local:
                raise BankError(
                    "a scene names an object that the bank's record does not",
                    hint="the bank's own bank.json",
                )
            if is_there:
                placed[row, local[number]] = True
                poses[row, local[number]] = pose
    return poses, placed


def certificates(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    seconds: float = 2.0,
    num_threads: int = 0,
) -> list[dict[str, Any]]:
    """One certificate a scene, ready to become a bank's columns.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: the horizon of drift; by default that of the last check's second stage.

    Returns:
      For each scene
        residual_speed: m/s, the fastest origin after the scene was let go for 0.25 s.
        residual_angular_speed: rad/s, likewise.
        drift, drift_turn: metres and radians, the most that anything was from its start within the horizon,
          with either of MuJoCo's detectors of convex collisions.
        detectors: those with which it stands (`physics.standing`); all else is measured with native's.
        drift_seconds: the horizon.
        penetration: metres, the deepest overlap of two bodies.
        num_contacts: contact points.
        shake: m/s^2, the smaller of the scores along world x and y (`robustness.shake`).
        shake_x, shake_y: both of them, where these are the directions.
        rests_on: list of (i, j): object i rests on object j; indices of the world's objects, -1 the support.
        margin: metres, the least support margin; None if nothing is carried from below.
        margins: metres, each of the world's K objects'; None where not placed or not carried from below.
        tilt_1, tilt_2, tilt_5: share of directions in which gravity, tilted by so many degrees, topples
          nothing.
        robust: it stands in soft contact, with less friction and gravity tilted (`robustness.robust`).
    """
    tilt_config = TiltConfig()
    contacts = contacts_of(models, poses, is_placed, num_threads)
    drifts = {
        name: movement(models.with_detector(name), poses, is_placed, (seconds,), num_threads)
        for name in DETECTORS
    }
    scores = shake(models, poses, is_placed, num_threads=num_threads)
    speeds = residual_speeds(models, poses, is_placed, num_threads)
    stands = tilt(models, poses, is_placed, tilt_config, num_threads)
    is_robust = robust(models, poses, is_placed, num_threads=num_threads)
    rests_on = contacts.rests_on
    margins = [[finite(each) for each in row] for row in contacts.margin]
    return [
        {
            "residual_speed": float(speeds[n, 0]),
            "residual_angular_speed": float(speeds[n, 1]),
            "drift": max(float(each.largest_shift[n, 0]) for each in drifts.values()),
            "drift_turn": max(float(each.largest_turn[n, 0]) for each in drifts.values()),
            "drift_seconds": float(seconds),
            "penetration": float(contacts.penetration[n]),
            "num_contacts": int(contacts.count[n]),
            "shake": float(scores[n].min()),
            "shake_x": float(scores[n, 0]),
            "shake_y": float(scores[n, -1]),
            "rests_on": support_edges(rests_on[n]),
            "margin": min((each for each in margins[n] if each is not None), default=None),
            "margins": margins[n],
            **{
                f"tilt_{by:g}": float(share)
                for by, share in zip(tilt_config.degrees, stands[n], strict=True)
            },
            "robust": bool(is_robust[n]),
            "detectors": [name for name, each in drifts.items() if each.survives()[n, 0]],
        }
        for n in range(len(is_placed))
    ]


def support_edges(rests_on: np.ndarray) -> list[tuple[int, int]]:
    """The support graph of one scene, bool[K, K + 1], as pairs (who rests, on whom), -1 for the support."""
    size = rests_on.shape[0]
    return [(int(i), -1 if j == size else int(j)) for i, j in np.argwhere(rests_on)]


def residual_speeds(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    num_threads: int = 0,
    seconds: float = 0.25,
) -> np.ndarray:
    """f64[N, 2]: m/s and rad/s of the fastest object `seconds` after scenes were let go from rest."""

    def run(_: int, model: StandingModel, at: np.ndarray) -> tuple[float, float]:
        data = model.start(at)
        mujoco.mj_step(model.model, data, round(seconds / model.model.opt.timestep))
        velocity = data.qvel.reshape(-1, 2, 3)
        linear, angular = np.linalg.norm(velocity, axis=2).max(0, initial=0.0)
        return float(linear), float(angular)

    found = models.each(run, poses, is_placed, num_threads)
    return np.array(found, np.float64).reshape(-1, 2)
