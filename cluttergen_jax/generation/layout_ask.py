"""A layout from a sentence: a language model writes it, it is checked, and what is wrong is sent back.

A model is a command that reads a prompt and prints an answer, an endpoint of the usual chat form
(POST .../chat/completions), or a function in Python. Nothing else of the package needs one.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import shlex
import signal
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit

import msgspec
import yaml

from cluttergen_jax.assets.facts import ObjectFacts
from cluttergen_jax.assets.pool import Pool
from cluttergen_jax.assets.support_file import find_support, list_supports
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest, printable
from cluttergen_jax.files import write_atomically
from cluttergen_jax.generation.layout_check import (
    Asked,
    LayoutCheck,
    LayoutFault,
    check_text,
    layout_schema,
    parse_content,
    pool_of,
    read_fields,
)
from cluttergen_jax.progress import run_abandonable
from cluttergen_jax.schema import SchemaError
from cluttergen_jax.spec import SceneSpec

MOST_TRIES = 5
_MOST_ANSWER = 1 << 20
"""Bytes of an answer."""
_MOST_LISTED = 400
"""Objects of a pool that are listed one by one; of more, what people call them and how many there are."""
_MOST_LABELS = 1000
_SAID = 1500
"""Letters of what a command or a server says of its failure."""
_PAUSE = 0.05
"""Seconds between two looks at a command."""
Model = Callable[[str], str]
"""Answers a prompt."""


class ModelError(ClutterGenError):
    """A language model did not answer, or not with a layout that can be used."""


@dataclass(frozen=True)
class Answer:
    """What a model has answered, and what is wrong with the layout in it."""

    text: str
    faults: tuple[LayoutFault, ...]


@dataclass(frozen=True, eq=False)
class AskedLayout:
    """A layout that a model has written.

    Attributes:
      text: its YAML, with who wrote it (`asked`).
      asked: the request, the model and how many answers it took.
      spec: the request for scenes; notes: what may make it hard to fulfil.
      answers: all of the model's, the last one is right; none where an earlier layout was taken.
      path: its file, if it has one.
    """

    text: str
    asked: Asked
    spec: SceneSpec
    notes: tuple[str, ...] = ()
    answers: tuple[Answer, ...] = ()
    path: Path | None = None

    def __str__(self) -> str:
        tries = "1 answer" if self.asked.tries == 1 else f"{self.asked.tries} answers"
        number = len(self.spec.relations)
        lines = [
            f"layout     {self.spec.num_objects} objects, {number} relations; "
            f"{self.asked.model}, {tries}"
        ]
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join([*lines, *([f"written    {self.path}"] if self.path else [])])


def ask_for_layout(
    request: str,
    model: Model,
    name: str,
    options: Mapping[str, Any],
    *,
    timeout: float,
    max_tries: int,
    show: Callable[[str], None],
    log: Path | None = None,
) -> AskedLayout:
    """A layout of a model without faults; see `cluttergen_jax.layout.ask`.

    Args:
      name: of the model.
      options: fields of `SceneSpec`, `pool` among them.
      log: a JSON file of all prompts and answers, whole after every one.
    """
    pool = str(options["pool"])
    found = pool_of(pool, options.get("exclude", ()))
    first = prompt_of(request, found.facts, pool, options.get("support"))
    prompt = first
    answers: list[Answer] = []
    for number in range(1, max_tries + 1):
        text = _in_time(timeout, model, prompt)
        content, check = _read_answer(text, options, found)
        answers.append(Answer(text, check.faults))
        record = {
            "request": request,
            "model": name,
            "prompt": first,
            "answers": [
                {"answer": each.text, "errors": [str(fault) for fault in each.faults]}
                for each in answers
            ],
        }
        if log is not None:
            write_atomically(log, (json.dumps(record, indent=1) + "\n").encode())
        count = len(check.faults)
        told = "sound" if not count else "1 error" if count == 1 else f"{count} errors"
        show(f"asked {number} of {max_tries}: {told}")
        if check.spec is not None:
            asked = Asked(request=request, model=name, tries=number)
            layout = {
                **content,
                "pool": pool,
                **({"support": str(options["support"])} if "support" in options else {}),
                "asked": msgspec.to_builtins(asked),
            }
            written = yaml.safe_dump(layout, sort_keys=False, allow_unicode=True, width=100)
            return AskedLayout(written, asked, check.spec, check.notes, tuple(answers))
        prompt = _prompt_again(first, text, check.faults)
    last = "\n".join(f"  {fault}" for fault in answers[-1].faults)
    kept = f"; all answers are in {log}" if log is not None else ""
    tries = "1 answer" if max_tries == 1 else f"{max_tries} answers"
    raise _Unsound(f"no layout without errors in {tries} of {name}{kept}", last)


class _Unsound(ModelError):
    def __init__(self, given: str, faults: str) -> None:
        super().__init__(given, hint="another model, or a simpler request")
        self.args = (f"{self.args[0]} The errors of the last answer:\n{faults}",)


# Prompts


def prompt_of(request: str, facts: Sequence[ObjectFacts], pool: str, support: str | None) -> str:
    """What a model is asked: the request, the schema of a layout, and what there is.

    Args:
      facts: of the objects of the pool of that name.
      support: what they stand on; the model chooses if None.
    """
    schema = layout_schema()
    decided = ["pool", "asked", *([] if support is None else ["support"])]
    for name in decided:
        schema["properties"].pop(name)
    schema.pop("$defs", None)
    return "\n".join(
        [
            "Write a layout: which objects stand where on a table. A simulator makes scenes of it.",
            "",
            f"The request: {request}",
            "",
            "Answer with one YAML document in one code block. Its JSON schema:",
            json.dumps(schema),
            "",
            *_objects_text(facts, pool),
            "",
            *_supports_text(support),
            "",
            "Use only these objects, the most fitting ones. Name the relations that make the scene "
            "plausible, and no more: each must hold exactly, and what stands on the table needs room.",
        ]
    )


def _objects_text(facts: Sequence[ObjectFacts], pool: str) -> Iterator[str]:
    if len(facts) <= _MOST_LISTED:
        yield f"The objects of the pool {pool}, NAME: what people call it, width x depth x height in cm:"
        for each in facts:
            size = " x ".join(f"{100 * side:.0f}" for side in each.size)
            yield f"{each.name}: {each.label}, {size}"
        return
    labels = Counter(each.label or each.name for each in facts)
    yield (
        f"The pool {pool} has {len(facts)} objects. What people call them, and how many there are; write "
        "label=WORDS in `objects` to mean one of these:"
    )
    for label, number in labels.most_common(_MOST_LABELS):
        yield f"{label}: {number}"


def _supports_text(support: str | None) -> Iterator[str]:
    names = list(list_supports()) if support is None else [str(support)]
    yield (
        "The support that is used, its width x depth in m:"
        if support
        else (
            "Supports, for `support`, width x depth in m (table-1.20x0.70 is a table of any such size):"
        )
    )
    for name in names:
        try:
            half = find_support(name).region.half_extents
        except ClutterGenError:
            continue  # A damaged one of the user's own; `cluttergen list` tells of it.
        yield f"{name}: {2 * half[0]:.2f} x {2 * half[1]:.2f}"


def _prompt_again(first: str, answer: str, faults: Sequence[LayoutFault]) -> str:
    lines = "\n".join(f"- {fault}" for fault in faults)
    return (
        f"{first}\n\nYour last answer was:\n{answer[:_MOST_ANSWER]}\n\nIt has errors:\n{lines}\n\n"
        "Write the whole layout again without these errors."
    )


# Answers

_FENCED = re.compile(r"^[ \t]*(```+|~~~+)[^\n]*\n(.*?)^[ \t]*\1[ \t]*$", re.MULTILINE | re.DOTALL)
_BEGIN = re.compile(r"^(\{|[a-z_]+[ \t]*:)", re.MULTILINE)
_THOUGHT = re.compile(r"<(think|thinking|reasoning)>.*?</\1>", re.DOTALL)


def layout_in(answer: str) -> str:
    """The layout's text in an answer: in a code block, or behind some words, or all of it."""
    answer = _THOUGHT.sub("", answer).replace("\r\n", "\n").strip()
    blocks = [found[2] for found in _FENCED.finditer(answer)]
    # A model that forgets the block often says something first.
    start = _BEGIN.search(answer)
    bare = answer[start.start() :] if start else answer
    for text in (*reversed(blocks), bare):
        with suppress(SchemaError):
            content = parse_content(text.encode("utf-8", "replace"))
            if isinstance(content, dict) and "objects" in content:
                return text
    return blocks[-1] if blocks else bare


def _read_answer(
    answer: str, options: Mapping[str, Any], pool: Pool
) -> tuple[dict[str, Any], LayoutCheck]:
    """The mapping in an answer, and all that is wrong with it."""
    if not answer.strip():
        return {}, LayoutCheck((LayoutFault("", "the answer is empty", "a layout in YAML"),))
    text = layout_in(answer)
    check = check_text(text.encode("utf-8", "replace"), options, pool)
    try:
        content = parse_content(text.encode("utf-8", "replace"))
    except SchemaError:
        return {}, check
    if not isinstance(content, dict):
        return {}, check
    content.pop("asked", None)
    layout, _ = read_fields(content)
    faults = list(check.faults)
    for field in ("pool", "support"):
        given = getattr(layout, field)
        if field in content and field in options and given != str(options[field]):
            faults.append(LayoutFault(field, f"{given!r}", f"{options[field]}", "leaving it out"))
    return content, LayoutCheck(tuple(faults)) if faults else check


# Models


def model_of(
    given: str | Model, model_name: str, key_env: str, timeout: float
) -> tuple[Model, str]:
    """What answers, and what it is called.

    Args:
      given: a URL, a command or a function.
      model_name: what an endpoint is to call the model; the name that is recorded.
      key_env: the environment variable that holds the key of an endpoint.

    Raises:
      ConfigError: it is none of these, the variable is not set, or there is no such command.
    """
    if callable(given):
        return given, model_name or getattr(given, "__name__", type(given).__name__)
    if not isinstance(given, str) or not given.strip():
        raise ConfigError(
            f"model = {given!r}", "a URL, a command, or in Python a function", _MODEL_HINT
        )
    if re.match(r"[a-zA-Z][a-zA-Z0-9+.-]*://", given):
        endpoint = _Endpoint.of(given, model_name, key_env, timeout)
        return endpoint, model_name or endpoint.host
    if key_env:
        raise ConfigError(
            f"key_env = {key_env!r} for a command", "the key of an endpoint", "leaving it out"
        )
    try:
        words = shlex.split(given)
    except ValueError as error:
        raise ConfigError(f"model = {given!r} ({error})", "a command", _MODEL_HINT) from error
    if not words:
        raise ConfigError(f"model = {given!r}", "a URL or a command", _MODEL_HINT)
    # What follows the first option may be anything, a key too, and paths are this machine's.
    known = [Path(word).name for word in words]
    options = [place for place, word in enumerate(words) if word.startswith("-")]
    return _Command(words, timeout), model_name or " ".join(known[: min([*options, len(words)])])


_MODEL_HINT = "'python my_model.py', or 'http://localhost:8000/v1' with `model_name`"


def _in_time(seconds: float, model: Model, prompt: str) -> str:
    """A model's answer, or a ModelError after so many seconds; Ctrl-C ends the wait."""
    end = time.monotonic() + seconds

    def is_late() -> bool:
        if time.monotonic() > end:
            raise _late(seconds)
        return False

    answer = (
        model(prompt) if isinstance(model, _Command) else run_abandonable(is_late, model, prompt)
    )
    if not isinstance(answer, str):
        raise ModelError(f"the model answered {type(answer).__name__}", "text")
    if len(answer) > _MOST_ANSWER:
        raise ModelError(f"an answer of {len(answer):,} letters", f"up to {_MOST_ANSWER:,}")
    return answer


def _late(seconds: float) -> ModelError:
    return ModelError(
        f"no answer within {seconds:g} s", hint=f"another model, or timeout={2 * seconds:g}"
    )


@dataclass(frozen=True)
class _Command:
    """A program that reads a prompt and prints an answer; it and what it has started end with the wait."""

    words: Sequence[str]
    timeout: float

    def __call__(self, prompt: str) -> str:
        with (
            tempfile.TemporaryFile() as given,
            tempfile.TemporaryFile() as out,
            tempfile.TemporaryFile() as err,
        ):
            given.write(prompt.encode())
            given.seek(0)
            try:
                process = subprocess.Popen(
                    self.words, stdin=given, stdout=out, stderr=err, start_new_session=True
                )
            except OSError as error:
                raise ConfigError(
                    f"model = {shlex.join(self.words)!r}: {self.words[0]}: {error.strerror}",
                    "a command that reads a prompt and prints an answer, or a URL",
                    _MODEL_HINT,
                ) from error
            try:
                status = self._wait(process, out, err)
            finally:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            if status:
                said = _read_end(err) or _read_end(out) or "it said nothing"
                raise ModelError(
                    f"{self.words[0]} ended with status {status}: {said}",
                    hint="the command by itself, with a prompt as its input",
                )
            out.seek(0)
            return out.read(_MOST_ANSWER + 1).decode("utf-8", "replace")

    def _wait(self, process: subprocess.Popen[bytes], *files: IO[bytes]) -> int:
        end = time.monotonic() + self.timeout
        while True:
            try:
                return process.wait(_PAUSE)
            except subprocess.TimeoutExpired:
                if time.monotonic() > end:
                    raise _late(self.timeout) from None
                if any(os.fstat(each.fileno()).st_size > _MOST_ANSWER for each in files):
                    raise ModelError(
                        f"{self.words[0]} printed more than {_MOST_ANSWER:,} bytes",
                        "a layout alone",
                    ) from None


def _read_end(file: IO[bytes]) -> str:
    """The last letters of what a program has written."""
    file.seek(0)
    return file.read().decode("utf-8", "replace").strip()[-_SAID:]


@dataclass(frozen=True, repr=False)
class _Endpoint:
    """The usual chat form: POST {base}/chat/completions."""

    url: str
    host: str
    model_name: str
    key: str
    timeout: float

    @staticmethod
    def of(base: str, model_name: str, key_env: str, timeout: float) -> _Endpoint:
        try:
            parts = urlsplit(base)
            host = parts.hostname or ""
            port = f":{parts.port}" if parts.port else ""
        except ValueError as error:
            raise ConfigError(f"model = {base!r} ({error})", "a URL", _MODEL_HINT) from error
        if parts.scheme not in ("http", "https") or not host:
            raise ConfigError(f"model = {base!r}", "http:// or https://", _MODEL_HINT)
        if "@" in parts.netloc:
            raise ConfigError(
                f"model = {parts.scheme}://...@{host}", "no user or password in it", "`key_env`"
            )
        key = os.environ.get(key_env, "") if key_env else ""
        if key_env and not key.strip():
            meant = closest(key_env, os.environ)
            raise ConfigError(
                f"key_env = {key_env!r}, a variable that is not set",
                "the name of an environment variable that holds the key",
                f"export {key_env}=...",
                meant,
            )
        if "\n" in key.strip() or not key.isascii():
            raise ConfigError(f"the variable {key_env} holds no key", "letters of ASCII, one line")
        url = base.rstrip("/")
        if not url.endswith("/chat/completions"):
            url += "/chat/completions"
        return _Endpoint(url, f"{host}{port}", model_name, key.strip(), timeout)

    def __call__(self, prompt: str) -> str:
        question: dict[str, Any] = {"messages": [{"role": "user", "content": prompt}]}
        if self.model_name:
            question["model"] = self.model_name
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        try:
            asked = urllib.request.Request(
                self.url, json.dumps(question).encode(), headers, method="POST"
            )
            opener = urllib.request.build_opener(_NoRedirect)
            with opener.open(asked, timeout=self.timeout) as response:
                data = response.read(4 * _MOST_ANSWER)
        except urllib.error.HTTPError as error:
            with suppress(OSError, http.client.HTTPException), error:
                said = error.read(_SAID).decode("utf-8", "replace").strip()
                raise self._failure(f"status {error.code}: {said or error.reason}") from error
            raise self._failure(f"status {error.code}") from error
        except (OSError, http.client.HTTPException, ValueError) as error:
            reason = getattr(error, "reason", None) or error
            raise self._failure(str(reason) or type(error).__name__) from error
        return self._content(data)

    def _content(self, data: bytes) -> str:
        try:
            message = json.loads(data)["choices"][0]["message"]
            content = message["content"]
            if isinstance(content, list):
                content = "".join(part.get("text", "") for part in content)
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            said = data[:_SAID].decode("utf-8", "replace")
            raise self._failure(f"no choices[0].message.content in {said!r}") from error
        return content if isinstance(content, str) else ""

    def _failure(self, reason: str) -> ModelError:
        if self.key:
            reason = reason.replace(self.key, "...")
        return ModelError(
            f"{self.url}: {printable(reason)}",
            hint="the base of a chat endpoint, such as http://localhost:8000/v1, its `model_name`, "
            "and `key_env` where it wants a key",
        )


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """A key goes to the host that was named, and to no other."""

    def redirect_request(self, *args: Any, **more: Any) -> None:
        return None
