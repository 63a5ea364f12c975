"""What the viewer says about a scene and an attempt, in Markdown."""

from __future__ import annotations

from collections import Counter

import numpy as np

from cluttergen_jax.placement.hand import Check, Drop, HandScene, Lowered
from cluttergen_jax.placement.replay import Replay
from cluttergen_jax.types import Verdict, small_length


def scene_words(recording: Replay, note: str = "") -> str:
    """The verdict and the figures of a scene; `note` is added below."""
    verdicts = {each.label: each for each in Verdict}
    verdict = verdicts.get(recording.verdict)
    if recording.is_success:
        text = "stands" if verdict is not None else recording.verdict or "stands"
    else:
        text = f"failed: {recording.verdict}" + (
            f" ({verdict.sentence})" if verdict is not None else ""
        )
    lines = [f"**{recording.title}** {text}", f"objects placed: {len(recording.placed)}"]
    if recording.drift > 0:
        lines.append(f"largest movement in the last check: {small_length(recording.drift)}")
    if recording.attempts:
        failures = Counter(attempt.verdict.label for attempt in recording.failures)
        counted = ", ".join(f"{number} {label}" for label, number in failures.most_common())
        lines.append(
            f"attempts: {len(recording.attempts)}" + (f", of which {counted}" if counted else "")
        )
    if note:
        lines.append(note)
    return "\n\n".join(lines)


def attempt_words(recording: Replay, number: int) -> str:
    """What happened at attempt `number`, from 1; 0 is the beginning."""
    if not recording.attempts:
        return "attempts: not known"
    if number == 0:
        return f"before the first of {len(recording.attempts)} attempts"
    attempt = recording.attempts[number - 1]
    asset = recording.objects[attempt.object_index]
    name = f"**{asset.label or asset.name}**, its attempt {attempt.ordinal}"
    lines = [f"attempt {number} of {len(recording.attempts)}: {name}"]
    taken = [recording.objects[index] for index in recording.taken_away(number - 1)]
    if taken:
        lines.append(
            f"taken away before it: {', '.join(each.label or each.name for each in taken)}"
        )
    end = f"failed, {attempt.verdict.label}: {attempt.verdict.sentence} ({attempt.num_steps} steps)"
    if attempt.is_stable:
        end = f"stable after {attempt.num_steps} steps"
        end += "" if attempt.gathered is None else "; then all were drawn together"
    return "\n\n".join([*lines, end])


def progress_words(scene: HandScene) -> str:
    """How far a scene made by hand has come."""
    minutes, seconds = divmod(int(scene.clock.seconds), 60)
    placed = f"{scene.num_placed} of {len(scene.all)} objects placed"
    tries = f"{scene.num_attempts} attempt{'' if scene.num_attempts == 1 else 's'}"
    text = f"**scene {scene.number}**: {placed}, {tries}, {minutes}:{seconds:02d}"
    return f"{text}\n\nleft: {', '.join(scene.names[index] for index in scene.left) or 'nothing'}"


def lowered_words(scene: HandScene, lowered: Lowered) -> str:
    """What the current object touches."""
    assert scene.current is not None
    name = scene.names[scene.current]
    if lowered.is_on_top:
        text = f"{name} touches the bare top"
    else:
        text = f"{name} touches something {100 * lowered.lift:.1f} cm above the bare top"
    return text + (f"; {lowered.hanging:.0%} of it is over nothing" if lowered.hanging > 0 else "")


def drop_words(scene: HandScene, drop: Drop) -> str:
    """What came of an attempt, by which verdict, and why."""
    attempt = drop.attempt
    verdict = attempt.verdict
    name = scene.names[attempt.object_index]
    if verdict == Verdict.STABLE:
        return f"**{name}: stable** after {attempt.num_steps} steps"
    text = f"**{name}: {verdict.label}**: {verdict.sentence}"
    if verdict == Verdict.DISPLACED and drop.mover is not None:
        moved = f"{small_length(drop.shift)} and {np.degrees(drop.turn):.1f} degrees"
        text += f" ({scene.names[drop.mover]}: by {moved} at most)"
    elif verdict == Verdict.PENETRATING:
        text += f" (by {small_length(drop.penetration)})"
    elif verdict == Verdict.UNSUPPORTED and np.isfinite(drop.margin):
        text += f" ({1000 * drop.margin:.1f} mm inside it)"
    return f"{text}. In red, where it ended; the scene is what it was before."


def check_words(scene: HandScene, check: Check) -> str:
    """What came of the last check."""
    if check.verdict == Verdict.STABLE:
        most = small_length(check.drift)
        return f"all {len(scene.all)} objects stand together (none moved more than {most})"
    name = scene.names[check.mover]
    moved = small_length(check.drift)
    return (
        f"**not saved: {check.verdict.label}**: {check.verdict.sentence} ({name}: by {moved}). Take objects "
        "back and place them better, or give the scene up"
    )
