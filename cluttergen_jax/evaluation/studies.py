"""Running a study: its trials, its measure, its plots; the result is plain JSON."""

from __future__ import annotations

import datetime
import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cluttergen_jax.evaluation.checkpoints import MissingCheckpointError
from cluttergen_jax.evaluation.lab import Lab
from cluttergen_jax.evaluation.machine import machine
from cluttergen_jax.evaluation.measuring import KEPT_BY_ROW, MEASURES
from cluttergen_jax.evaluation.plots import PLOTS
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.evaluation.suites import Study
from cluttergen_jax.evaluation.trial import key_of
from cluttergen_jax.files import inside

Result = dict[str, Any]
_SHOWN = ("trial", "policy", "figures", "missing", "hint")


def run_study(lab: Lab, study: Study, folder: Path, suite: str, command: str, quick: bool) -> Result:
    """Runs what is not at hand.

    Args:
      folder: where pictures go; results of measures lie in its `results`, beside those of trials.
      command: what a reader would type to make the study again.
      quick: fewer trials were made than the study asks for, on purpose.
    """
    lab.progress.say(f"{study.name}: {study.title}")
    needs_records = not study.measure or study.measure == "renders"
    records = [lab.record(trial) for trial in study.trials] if needs_records else []
    measured = _measured(lab, study, folder) if study.measure else None
    layout = study.layout or study.name
    made = [record for record in records if "figures" in record]
    pictures = list(measured["pictures"]) if measured else []
    if made and layout in PLOTS:
        pictures += PLOTS[layout](made, folder / study.name)
    return {
        "format": FORMAT,
        "suite": suite,
        "name": study.name,
        "title": study.title,
        "layout": layout,
        "command": command,
        "quick": quick,
        "size": study.size,
        "trials": sorted({trial.trials for trial in study.trials}),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": machine(),
        "records": [{name: record[name] for name in _SHOWN if name in record} for record in records],
        "measure": measured,
        "pictures": pictures,
    }


def _measured(lab: Lab, study: Study, folder: Path) -> dict[str, Any]:
    """The measure's findings: those at hand if they are of the same trials, else made now."""
    if study.measure in KEPT_BY_ROW:
        return MEASURES[study.measure](lab, study, folder)
    key, title = _measure_key(lab, study), f"measure {study.name}"
    stored = None if lab.is_fresh else lab.store.read(title, key)
    if stored and all(inside(folder, name).is_file() for name in stored["figures"]["pictures"]):
        return stored["figures"]
    lab.progress.begin(f"measuring {study.name}")
    return lab.store.keep(title, key, MEASURES[study.measure](lab, study, folder))


def _measure_key(lab: Lab, study: Study) -> str:
    """Equal for equal trials of equal content, checkpoints that are missing included."""
    parts: list[Any] = [study.measure]
    for trial in study.trials:
        try:
            parts.append(key_of(trial, lab.sources(trial)))
        except MissingCheckpointError as error:
            parts.append([asdict(trial), str(error)])
        run = lab.checkpoints.run_folder(trial) if study.measure == "learning_curves" else None
        parts.append(run and (run / "progress.csv").stat().st_mtime_ns)
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:20]
