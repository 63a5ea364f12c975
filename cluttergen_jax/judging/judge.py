"""Files judged one after another, their starts on threads."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.config import Detector
from cluttergen_jax.errors import AssetError, ClutterGenError
from cluttergen_jax.judging.report import JudgedStart, JudgeReport
from cluttergen_jax.judging.rule import (
    FreeBodies,
    JudgeConfig,
    find_free_bodies,
    judge_start,
)
from cluttergen_jax.judging.scene_files import find_scenes, read_model, read_starts
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.progress import Progress

_Task = tuple[Path, str, Detector, mujoco.MjModel, mujoco.MjData, FreeBodies]


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
