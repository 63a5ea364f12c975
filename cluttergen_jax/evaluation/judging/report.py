"""What the judge found: rows, a table, files and a picture of the worst scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from cluttergen_jax.config import DETECTORS, Detector
from cluttergen_jax.evaluation.judging.rule import FALL, JudgeConfig, Judgement
from cluttergen_jax.evaluation.judging.scene_files import read_model
from cluttergen_jax.files import file_whole
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.tables import aligned_table

_SHOWN = 12
_RED, _GROUPS_SEEN = (0.86, 0.10, 0.12, 1.0), 3


@dataclass(frozen=True, eq=False)
class JudgedStart:
    """One start of a file by one detector.

    Attributes:
      file: where it is; start: its name in the file, "" if there is one alone.
      found: how it behaved.
      begin: f64[nq], where it started.
    """

    file: Path
    start: str
    detector: Detector
    found: Judgement
    begin: np.ndarray

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.file.name}:{self.start}" if self.start else self.file.name


@dataclass(frozen=True, eq=False)
class JudgeReport:
    """What `judge` found; printed, it says how many scenes and bodies are still, overlap, float and fall.

    Attributes:
      config: what was asked.
      starts: every start by every detector, in the order of the files.
      unread: why a file, or its states, cannot be judged, by file.
      notes: what was left out.
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
        rows = [row for each in self.starts for row in self._rows_of(each)]
        rows += [{"file": str(path), "error": reason} for path, reason in self.unread.items()]
        horizons = [f"{seconds:g}s" for seconds in self.config.seconds]
        schema = pa.schema(
            [
                *((name, pa.string()) for name in ("file", "start", "detector", "body")),
                *((f"is_still_{each}", pa.bool_()) for each in horizons),
                *((f"{name}_{each}", pa.float64()) for each in horizons for name in ("shift", "turn")),
                ("penetration", pa.float64()),
                ("against", pa.string()),
                *((name, pa.bool_()) for name in ("is_deep", "floats", "falls")),
                *((name, pa.string()) for name in ("note", "error", "mujoco")),
            ]
        )
        return pa.Table.from_pylist([row | {"mujoco": self.mujoco} for row in rows], schema)

    def _rows_of(self, each: JudgedStart) -> Iterator[dict[str, object]]:
        found = each.found
        for place, body in enumerate(found.names):
            row: dict[str, object] = {
                "file": str(each.file),
                "start": each.start,
                "detector": each.detector,
                "body": body,
                "penetration": found.penetration[place],
                "against": found.against[place],
                "note": found.note,
            }
            for name in ("is_deep", "floats", "falls"):
                row[name] = bool(getattr(found, name)[place])
            for horizon, seconds in enumerate(self.config.seconds):
                row[f"is_still_{seconds:g}s"] = bool(found.is_still[horizon, place])
                row[f"shift_{seconds:g}s"] = found.shift[horizon, place]
                row[f"turn_{seconds:g}s"] = found.turn[horizon, place]
            yield row

    def shares(self, detector: Detector, of_bodies: bool = False) -> dict[str, float]:
        """Number of starts (or bodies), shares that are still up to each horizon, overlap, float and fall."""
        found = [each.found for each in self.starts if each.detector == detector]

        def share(flags: list[np.ndarray], of_all: bool) -> float:
            if of_bodies:
                return float(np.concatenate(flags).mean()) if flags else np.nan
            return (
                float(np.mean([each.all() if of_all else each.any() for each in flags])) if flags else np.nan
            )

        number = sum(len(each.names) for each in found) if of_bodies else len(found)
        still = {
            f"still {seconds:g} s": share([each.is_still[horizon] for each in found], True)
            for horizon, seconds in enumerate(self.config.seconds)
        }
        return {
            "number": number,
            **still,
            "overlap": share([each.is_deep for each in found], False),
            "float": share([each.floats for each in found], False),
            "fall": share([each.falls for each in found], False),
        }

    def __str__(self) -> str:
        config, lines = self.config, []
        detectors = [name for name in DETECTORS if any(each.detector == name for each in self.starts)]
        if detectors:
            shares = [
                (f"{kind}, {name}", self.shares(name, kind == "bodies"))
                for kind in ("scenes", "bodies")
                for name in detectors
            ]
            cells = [
                [name, str(each.pop("number")), *(f"{v:.3f}" for v in each.values())] for name, each in shares
            ]
            lines.append(aligned_table(["", "number", *shares[0][1]], cells))
        lines.append(
            f"MuJoCo {self.mujoco}, from rest, everything awake, each file's own options; still: never more "
            f"than {1000 * config.max_shift:g} mm or {config.max_turn_deg:g} deg from the start; overlap: "
            f"deeper than {1000 * config.max_penetration:g} mm at the start; float: nothing carries it at "
            f"the start; fall: more than {1000 * FALL:g} mm lower at the end"
        )
        lines += self.notes
        lines += _shortened(
            [f"{each.name}, {each.detector}: {_worst_text(each.found)}" for each in self._worst_first()]
        )
        lines += _shortened([f"{path} cannot be judged: {reason}" for path, reason in self.unread.items()])
        return "\n".join(lines)

    def _worst_first(self) -> list[JudgedStart]:
        """The starts with faults, by the worse detector; those in which most bodies moved first."""

        def badness(each: JudgedStart) -> tuple[int, float, int]:
            moved = int((~each.found.is_still[-1]).sum())
            return moved, float(each.found.shift[-1].max()), _num_faults(each.found)

        worse: dict[tuple[Path, str], JudgedStart] = {}
        for each in sorted(filter(lambda each: _num_faults(each.found), self.starts), key=badness):
            worse[each.file, each.start] = each
        return sorted(worse.values(), key=badness, reverse=True)

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
        can_draw, message = renderer_status()
        if not bad or not can_draw:
            return f"report     {out / 'report.csv'}" + ("" if can_draw else f"; no picture: {message}")
        return f"report     {out / 'report.csv'}, {draw(bad[0], out / 'worst.png').name}: {bad[0].name}"


def _num_faults(found: Judgement) -> int:
    return int((~found.is_still[-1]).sum() + found.is_deep.sum() + found.floats.sum() + found.falls.sum())


def _shortened(lines: list[str]) -> list[str]:
    return lines[:_SHOWN] + [f"and {len(lines) - _SHOWN} more"] * (len(lines) > _SHOWN)


def _mm(metres: float) -> str:
    return f"{1000 * metres:,.1f} mm"


def _worst_text(found: Judgement) -> str:
    """What is wrong in a start, in words."""
    far, parts = int(np.argmax(found.shift[-1])), []
    if number := int((~found.is_still[-1]).sum()):
        turn = np.degrees(found.turn[-1, far])
        parts.append(
            f"{number} of {len(found.names)} moved, {found.names[far]} by {_mm(found.shift[-1, far])} "
            f"and {turn:.0f} deg"
        )
    if found.is_deep.any():
        deep = int(np.argmax(found.penetration))
        parts.append(f"{found.names[deep]} is {_mm(found.penetration[deep])} deep in {found.against[deep]}")
    for what, flags in (("floats", found.floats), ("falls", found.falls)):
        if names := [name for name, flag in zip(found.names, flags, strict=True) if flag]:
            parts.append(f"{', '.join(names[:3])}{' and others' if len(names) > 3 else ''} {what}")
    return "; ".join(parts + [found.note] * bool(found.note))


def draw(each: JudgedStart, path: Path) -> Path:
    """A picture of a start and of its end side by side, what moved in red."""
    from cluttergen_jax.assets.mjcf import VISUAL_GROUP
    from cluttergen_jax.rendering.camera import drawn_points
    from cluttergen_jax.rendering.picture import contact_sheet, render_model, save_png
    from cluttergen_jax.rendering.renderer import HIDDEN_GROUP

    model, found = read_model(each.file), each.found
    is_seen = (model.geom_group < _GROUPS_SEEN) & (model.geom_rgba[:, 3] > 0)
    names = [model.body(int(body)).name or f"body-{body}" for body in model.body_rootid[model.geom_bodyid]]
    judged = np.isin(names, found.names)
    if not (is_seen & judged).any():
        is_seen[:] = True
    moved = [name for name, still in zip(found.names, found.is_still[-1], strict=True) if not still]
    is_moved = np.isin(names, moved)
    model.geom_matid[is_moved], model.geom_rgba[is_moved] = -1, _RED
    model.geom_group[:] = np.where(is_seen, VISUAL_GROUP, HIDDEN_GROUP)
    data = mujoco.MjData(model)
    data.qpos[:] = each.begin
    mujoco.mj_forward(model, data)
    focus = drawn_points(model, data, is_seen & judged)
    ends = [each.begin, *([found.qpos] if np.isfinite(found.qpos).all() else [])]
    images = [render_model(model, qpos, focus=focus, samples=8) for qpos in ends]
    captions = [f"{each.name}: start", "end"][: len(images)]
    return save_png(contact_sheet(images, captions, columns=2), path)
