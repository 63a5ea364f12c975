"""What the viewer says about a scene and an attempt, in Markdown."""

from __future__ import annotations

from collections import Counter

from cluttergen_jax.placement.rollout.replay import Attempt, Replay
from cluttergen_jax.types import Verdict, small_length


def scene_words(recording: Replay, note: str = "") -> str:
    """The verdict and the figures of a scene; `note` is added below."""
    verdicts = {each.label: each for each in Verdict}
    verdict = verdicts.get(recording.verdict)
    if recording.is_success:
        said = "stands" if verdict is not None else recording.verdict or "stands"
    else:
        said = f"failed: {recording.verdict}" + (f" ({verdict.sentence})" if verdict is not None else "")
    lines = [f"**{recording.title}** {said}", f"objects placed: {len(recording.placed)}"]
    if recording.drift > 0:
        lines.append(f"largest movement in the last check: {small_length(recording.drift)}")
    if recording.attempts:
        failures = Counter(attempt.verdict.label for attempt in recording.failures)
        counted = ", ".join(f"{number} {label}" for label, number in failures.most_common())
        lines.append(f"attempts: {len(recording.attempts)}" + (f", of which {counted}" if counted else ""))
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
    lines = [f"attempt {number} of {len(recording.attempts)}: {_object_words(recording, attempt)}"]
    taken = [recording.objects[index] for index in recording.taken_away(number - 1)]
    if taken:
        lines.append(f"taken away before it: {', '.join(each.label or each.name for each in taken)}")
    return "\n\n".join([*lines, _end(attempt)])


def _object_words(recording: Replay, attempt: Attempt) -> str:
    asset = recording.objects[attempt.object_index]
    return f"**{asset.label or asset.name}**, its attempt {attempt.ordinal}"


def _end(attempt: Attempt) -> str:
    if attempt.is_stable:
        return f"stable after {attempt.num_steps} steps"
    return f"failed, {attempt.verdict.label}: {attempt.verdict.sentence} ({attempt.num_steps} steps)"
