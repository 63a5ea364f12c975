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
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.evaluation.judging.report import JudgedStart, JudgeReport
from cluttergen_jax.evaluation.judging.rule import JudgeConfig, check_steps, find_free_bodies, judge_start
from cluttergen_jax.evaluation.judging.scene_files import find_scenes, read_model, read_starts
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.progress import Progress

_NONE_FREE = "no body in it moves freely"


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
    judged: dict[tuple[int, int, str], JudgedStart] = {}
    unread: dict[Path, str] = {}
    left_out, more_starts = Counter[str](), 0
    # MuJoCo keeps meshes that it has read, and takes a file of the same second for the one that it knows.
    mujoco.mj_clearCache(mujoco.mj_getCache())
    threads = jobs or os.cpu_count() or 1

    def simulations() -> Iterator[tuple]:
        nonlocal more_starts
        for place, path in enumerate(files):
            try:
                model = read_model(path)
                bodies = find_free_bodies(model)
                left_out.update(bodies.left_out.values())
                if not len(bodies.index):
                    raise ClutterGenError(_NONE_FREE)
                check_steps(model, config)
                starts = read_starts(model, path, states, max_starts)
            except ClutterGenError as error:
                unread[path] = str(error)
                progress.update()
                continue
            more_starts += starts.left_out
            for number, (name, data) in enumerate(zip(starts.names, starts.data, strict=True)):
                for detector in detectors:
                    yield (place, number, detector), name, model, data, bodies
            progress.update()

    def simulate(model, data, bodies, detector):
        return judge_start(model, data, detector, bodies, config)

    with (
        silent_log(),
        Progress("judging", len(files), "file") as progress,
        ThreadPoolExecutor(threads) as pool,
    ):
        running: dict[Future, tuple] = {}

        def collect(most: int) -> None:
            while len(running) > most:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    key, name, data = running.pop(future)
                    judged[key] = JudgedStart(files[key[0]], name, key[2], future.result(), data.qpos.copy())
                progress.note(f"{len(judged)} simulations done")

        try:
            # As many wait as run, so that no more models are loaded than are needed.
            for key, name, model, data, bodies in simulations():
                running[pool.submit(simulate, model, data, bodies, key[2])] = key, name, data
                collect(2 * threads)
            collect(0)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    notes = [f"{number} free bodies are not judged: {why}" for why, number in left_out.items()]
    notes += [f"{more_starts} starts are not judged: at most {max_starts} of a file"] * bool(more_starts)
    notes += [f"{num_others} XML files are no scenes: parts of others, or of another kind"] * bool(num_others)
    order = sorted(judged, key=lambda key: (*key[:2], detectors.index(key[2])))
    return JudgeReport(config, tuple(judged[key] for key in order), unread, tuple(notes))
