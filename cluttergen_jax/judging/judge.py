"""Anybody's scenes judged one after another: rows, a table, a picture of the worst."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.config import DETECTORS, Detector
from cluttergen_jax.errors import AssetError, ClutterGenError
from cluttergen_jax.files import file_whole
from cluttergen_jax.judging.rule import (
    FAULTS,
    FreeBodies,
    JudgeConfig,
    Judgement,
    find_free_bodies,
    judge_start,
    length_in_mm,
)
from cluttergen_jax.judging.scene_files import find_scenes, read_model, read_starts
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering.camera import drawn_points
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.rendering.picture import contact_sheet, render_model, save_png
from cluttergen_jax.rendering.renderer import HIDDEN_GROUP
from cluttergen_jax.tables import aligned_table

_SHOWN = 12
_RED = (0.86, 0.10, 0.12, 1.0)
_GROUPS_SEEN = 3

_Task = tuple[Path, str, Detector, mujoco.MjModel, mujoco.MjData, FreeBodies]


@dataclass(frozen=True, eq=False)
class JudgedStart:
    """One start of a file, called `start` ("" if there is one alone), as one detector found it."""

    file: Path
    start: str
    detector: Detector
    found: Judgement

    def __str__(self) -> str:
        found = self.found
        name = f"{self.file.name}:{self.start}" if self.start else self.file.name
        far = int(found.shift[-1].argmax())
        parts = []
        if number := int((~found.is_still[-1]).sum()):
            moved = f"{length_in_mm(found.shift[-1, far])} and {np.degrees(found.turn[-1, far]):.0f} deg"
            parts.append(f"{number} of {len(found.names)} moved, {found.names[far]} by {moved}")
        parts += [each.describe(found) for each in FAULTS if getattr(found, each.column).any()]
        return f"{name}, {self.detector}: {'; '.join(filter(None, (*parts, found.note)))}"

    @property
    def badness(self) -> tuple[int, float, int]:
        """How many bodies moved, the farthest by how much, and how many other faults there are."""
        found = self.found
        others = sum(getattr(found, each.column).sum() for each in FAULTS)
        return int((~found.is_still[-1]).sum()), float(found.shift[-1].max()), int(others)


@dataclass(frozen=True, eq=False)
class JudgeReport:
    """What `judge` found; printed, it says how many scenes and bodies are still, overlap, float and fall.

    Attributes:
      config: what was asked.
      starts: every start by every detector, in the order of the files.
      unread: why a file, or its states, cannot be judged, by file.
      notes: what was left out, and what was written.
      mujoco: the version.
    """

    config: JudgeConfig
    starts: tuple[JudgedStart, ...]
    unread: dict[Path, str]
    notes: tuple[str, ...]
    mujoco: str = mujoco.__version__

    @cached_property
    def rows(self) -> pa.Table:
        """A row for each judged body of each start and detector, and one for each file that cannot be judged.

        Metres and radians; columns of motion for each horizon.
        """
        horizons = [f"{seconds:g}s" for seconds in self.config.seconds]
        columns: dict[str, Any] = {
            **dict.fromkeys(("file", "start", "detector", "body"), pa.string()),
            **{f"is_still_{each}": pa.bool_() for each in horizons},
            **{f"{name}_{each}": pa.float64() for each in horizons for name in ("shift", "turn")},
            **{"penetration": pa.float64(), "against": pa.string()},
            **dict.fromkeys((each.column for each in FAULTS), pa.bool_()),
            **dict.fromkeys(("note", "error", "mujoco"), pa.string()),
        }
        rows = [row for each in self.starts for row in self._rows_of(each, horizons)]
        rows += [{"file": str(path), "error": reason} for path, reason in self.unread.items()]
        return pa.Table.from_pylist(
            [row | {"mujoco": self.mujoco} for row in rows], pa.schema(columns)
        )

    def _rows_of(self, each: JudgedStart, horizons: list[str]) -> Iterator[dict[str, Any]]:
        found = each.found
        for place, body in enumerate(found.names):
            row = {
                "file": str(each.file),
                "start": each.start,
                "detector": each.detector,
                "body": body,
            }
            row |= {"note": found.note, "against": found.against[place]}
            row["penetration"] = found.penetration[place].item()
            row |= {each.column: getattr(found, each.column)[place].item() for each in FAULTS}
            for name in ("is_still", "shift", "turn"):
                values = getattr(found, name)[:, place].tolist()
                row |= {
                    f"{name}_{label}": value for label, value in zip(horizons, values, strict=True)
                }
            yield row

    def shares(self, detector: Detector, of_bodies: bool = False) -> dict[str, float]:
        """Number of starts (or bodies); shares that are still up to each horizon, overlap, float, fall."""
        found = [each.found for each in self.starts if each.detector == detector]

        def share(flags: list[np.ndarray], of_start: Callable[[np.ndarray], Any]) -> float:
            return float(
                np.mean(np.hstack(flags if of_bodies else [of_start(each) for each in flags]))
            )

        return {
            "number": sum(len(each.names) for each in found) if of_bodies else len(found),
            **{
                f"still {seconds:g} s": share([each.is_still[place] for each in found], np.all)
                for place, seconds in enumerate(self.config.seconds)
            },
            **{
                fault.title: share([getattr(each, fault.column) for each in found], np.any)
                for fault in FAULTS
            },
        }

    def __str__(self) -> str:
        config = self.config
        lines = []
        cells = []
        for kind in ("scenes", "bodies"):
            for name in DETECTORS:
                if any(each.detector == name for each in self.starts):
                    number, *shares = self.shares(name, kind == "bodies").values()
                    cells.append(
                        [f"{kind}, {name}", f"{number}", *(f"{each:.3f}" for each in shares)]
                    )
        if cells:
            still = (f"still {seconds:g} s" for seconds in config.seconds)
            titles = (fault.title for fault in FAULTS)
            lines.append(aligned_table(["", "number", *still, *titles], cells))
        meanings = [
            f"still: never more than {1000 * config.max_shift:g} mm or {config.max_turn_deg:g} deg from the "
            "start",
            *(f"{fault.title}: {fault.meaning(config)}" for fault in FAULTS),
        ]
        lines.append(
            f"MuJoCo {self.mujoco}, from rest, everything awake, each file's own options; "
            + "; ".join(meanings)
        )
        cannot = [f"{path} cannot be judged: {reason}" for path, reason in self.unread.items()]
        return "\n".join(
            [*lines, *self.notes, *_shorten([*map(str, self._worst_first())]), *_shorten(cannot)]
        )

    def _worst_first(self) -> list[JudgedStart]:
        """The starts with faults, by the worse detector; those in which most bodies moved first."""
        bad = [each for each in self.starts if each.badness[0] or each.badness[2]]
        worse = {
            (each.file, each.start): each for each in sorted(bad, key=lambda each: each.badness)
        }
        return sorted(worse.values(), key=lambda each: each.badness, reverse=True)

    def write(self, out: Path) -> str:
        """Writes report.csv, report.parquet and, where something is wrong, worst.png; a line that says so.

        Raises:
          OSError: it cannot be written.
        """
        out.mkdir(parents=True, exist_ok=True)
        with file_whole(out / "report.csv") as fresh:
            pyarrow.csv.write_csv(self.rows, fresh)
        with file_whole(out / "report.parquet") as fresh:
            pq.write_table(self.rows, fresh)
        bad = self._worst_first()
        (can_draw, message) = renderer_status()
        drawn = f", {draw(bad[0], out / 'worst.png').name}" if bad and can_draw else ""
        return f"report     {out / 'report.csv'}{drawn}" + (
            "" if can_draw else f"; no picture: {message}"
        )


def _shorten(lines: list[str]) -> list[str]:
    return lines[:_SHOWN] + [f"and {len(lines) - _SHOWN} more"] * (len(lines) > _SHOWN)


def draw(each: JudgedStart, path: Path) -> Path:
    """A picture of a start and of its end side by side, what moved in red."""
    model = read_model(each.file)[0]
    found = each.found
    is_seen = (model.geom_group < _GROUPS_SEEN) & (model.geom_rgba[:, 3] > 0)
    names = [
        model.body(int(body)).name or f"body-{body}"
        for body in model.body_rootid[model.geom_bodyid]
    ]
    is_judged = np.isin(names, found.names)
    if not (is_seen & is_judged).any():
        is_seen[:] = True
    is_moved = np.isin(names, np.array(found.names)[~found.is_still[-1]])
    model.geom_matid[is_moved] = -1
    model.geom_rgba[is_moved] = _RED
    model.geom_group[:] = np.where(is_seen, VISUAL_GROUP, HIDDEN_GROUP)
    if not model.nlight:
        model.vis.headlight.ambient = 0.4
        model.vis.headlight.diffuse = 0.6
    data = mujoco.MjData(model)
    data.qpos[:] = found.begin
    mujoco.mj_forward(model, data)
    focus = drawn_points(model, data, is_seen & is_judged)
    ends = [qpos for qpos in (found.begin, found.end) if np.isfinite(qpos).all()]
    images = [render_model(model, qpos, focus=focus, samples=8) for qpos in ends]
    captions = [f"{each.file.name} {each.start}: start", "end"][: len(images)]
    return save_png(contact_sheet(images, captions, columns=2), path)


def judge_scenes(
    paths: Sequence[str | Path],
    states: str | Path | np.ndarray | None,
    config: JudgeConfig,
    detectors: Sequence[Detector],
    max_starts: int,
    jobs: int,
) -> JudgeReport:
    """See `cluttergen_jax.judge`."""
    files, num_others = find_scenes(paths)
    unread: dict[Path, str] = {}
    changed: dict[Path, tuple[str, ...]] = {}
    left_out = Counter[str]()
    threads = jobs or os.cpu_count() or 1
    # MuJoCo keeps meshes that it has read, and takes a file of the same second for the one that it knows.
    mujoco.mj_clearCache(mujoco.mj_getCache())

    def tasks() -> Iterator[_Task]:
        for path in files:
            try:
                model, of_file = read_model(path)
                bodies = find_free_bodies(model)
                changed[path] = (*of_file, *bodies.notes)
                left_out.update(f"free bodies are not judged: {why}" for why in bodies.left_out)
                if not len(bodies.ids):
                    why = "; ".join(
                        f"free bodies are not judged: {each}"
                        for each in dict.fromkeys(bodies.left_out)
                    )
                    raise AssetError(f"no body in it moves freely{f' ({why})' if why else ''}")
                config.check_steps(model)
                starts, num_more = read_starts(model, path, states, max_starts)
                left_out[f"starts are not judged: at most {max_starts} of a file"] += num_more
                for name, data in starts:
                    yield from ((path, name, each, model, data, bodies) for each in detectors)
            except ClutterGenError as error:
                unread[path] = str(error)
            progress.update()

    def run(task: _Task) -> JudgedStart:
        path, name, detector, model, data, bodies = task
        return JudgedStart(path, name, detector, judge_start(model, data, detector, bodies, config))

    pool = ThreadPoolExecutor(threads)
    with silent_log(), Progress("judging", len(files), "file") as progress:
        started: list[Future[JudgedStart]] = []
        try:
            for task in tasks():
                started.append(pool.submit(run, task))
                # As many wait as run, so that no more models are loaded than are needed.
                while len(waiting := [each for each in started if not each.done()]) > 2 * threads:
                    wait(waiting, return_when=FIRST_COMPLETED)
                progress.note(f"{len(started) - len(waiting)} simulations done")
            judged = tuple(each.result() for each in started)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    left_out["XML files are no scenes: parts of others, or of another kind"] = num_others
    notes = [f"{number} {what}" for what, number in left_out.items() if number]
    files_of: dict[str, list[str]] = {}
    for path, of_file in changed.items():
        for note in of_file:
            files_of.setdefault(note, []).append(path.name)
    for note, names in files_of.items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        notes.append(f"{names[0]}{more}: {note}")
    return JudgeReport(config, judged, unread, tuple(notes))
