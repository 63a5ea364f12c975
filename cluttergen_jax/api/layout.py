"""Layouts checked, and written by a language model."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from cluttergen_jax.config import check_range
from cluttergen_jax.errors import ConfigError, printable
from cluttergen_jax.spec import SceneOptions, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.generation.layout_ask import AskedLayout
    from cluttergen_jax.generation.layout_check import LayoutCheck

ENDINGS = (".yaml", ".yml")
_SAID = "which the layout says"
_OF_LAYOUT = dict.fromkeys(("objects", "num_objects", "relations", "roles", "repeat"), _SAID)
_OF_LAYOUT |= dict.fromkeys(("sets", "shelf", "weights", "balance", "start"), "which no layout has")
"""Fields of a `SceneSpec` that are not given beside the sentence, and why."""


@takes_spec({"sets": "of which a layout is none"})
def check_layout(layout: str | Path, **options: Unpack[SceneOptions]) -> LayoutCheck:
    """Finds all that is wrong with a layout at once; `cluttergen layout check`.

    Names of objects, relations that are not understood or contradict each other, what cannot fit and too many
    objects, each with its place in the file, what is allowed, and what was probably meant. The arguments that
    are not explained here are those of `SceneSpec`.

    Args:
      layout: a YAML or JSON file, or a name of `cluttergen list`.
      options: fields of `SceneSpec`, in place of what the layout says.

    Returns:
      Its faults, and notes; printed, a line for each.

    Raises:
      ConfigError: there is no such file, or an option is refused.
    """
    from cluttergen_jax.generation.layout_check import check_text
    from cluttergen_jax.generation.layouts import layout_path
    from cluttergen_jax.schema import SchemaError, read_written
    from cluttergen_jax.spec import spec_of

    spec_of(check_layout, None, options)
    path = layout_path(layout)
    try:
        data = read_written(path)
    except (SchemaError, OSError) as error:
        raise ConfigError(f"layout {path}: {error}", "a YAML file") from error
    return check_text(data, options)


@takes_spec(_OF_LAYOUT, pool="all", support="")
def ask_layout(
    request: str,
    model: str | Callable[[str], str],
    out: str | Path | None = None,
    *,
    model_name: str = "",
    key_env: str = "",
    timeout: float = 120.0,
    max_tries: int = 5,
    overwrite: bool = False,
    show: Callable[[str], None] | None = None,
    **options: Unpack[SceneOptions],
) -> AskedLayout:
    """Has a language model write a layout for a sentence, and sends it its errors; `cluttergen layout ask`.

    The model gets the schema of a layout, the objects of the pool and the request. Its answer is checked as
    by `layout.check`. The arguments that are not explained here are those of `SceneSpec`.

    Args:
      request: what shall stand there, in words: "breakfast for two, messy".
      model: a URL, the base of an endpoint of the usual chat form (POST URL/chat/completions); or a command
        that reads a prompt on stdin and prints an answer; in Python also a function from prompt to answer.
      out: the layout's file, NAME.yaml, of which `generate` makes scenes; NAME.answers.json beside it keeps
        the prompt, every answer and its errors. A file of the same request and model is taken as it is. On
        the command line without .yaml: the folder of a bank, "out" if not given, made of the layout OUT.yaml.
      model_name: what the endpoint calls the model; recorded with the layout.
      key_env: the environment variable that holds the endpoint's key.
      timeout: seconds that an answer may take.
      max_tries: answers that it may take, 1 to 5.
      overwrite: ask again though the file is there.
      show: is given a line after each answer; they go to stderr if None.
      support: what the objects stand on; the model chooses if not given.
      options: fields of `SceneSpec` that are decided, in place of what the model would say.

    Returns:
      The layout; printed, a summary.

    Raises:
      ConfigError: an option is refused, or the file exists with another layout.
      ModelError: the model fails, takes too long, or writes no layout without errors.
      PoolError: there is no such pool or support.
    """
    from dataclasses import replace

    from cluttergen_jax.files import write_atomically
    from cluttergen_jax.generation.layout_ask import MOST_TRIES, ask_for_layout, model_of
    from cluttergen_jax.kept_folder import hold_file
    from cluttergen_jax.spec import spec_of

    spec_of(ask_layout, None, options)
    if not isinstance(request, str) or not request.strip():
        raise ConfigError(f"request = {request!r}", "a sentence", "'breakfast for two, messy'")
    check_range("max_tries", max_tries, 1, MOST_TRIES, MOST_TRIES)
    if not 0 < timeout < float("inf"):
        raise ConfigError(f"timeout = {timeout:g}", "seconds, more than 0", "timeout=120")
    path = None if out is None else Path(out)
    if path is not None and path.suffix not in ENDINGS:
        raise ConfigError(f"out = '{out}'", "a YAML file", f"out='{out}.yaml'")
    request = printable(" ".join(request.split()))
    answer, name = model_of(model, model_name, key_env, timeout)
    decided: dict[str, Any] = {"pool": "all", **options}
    if not decided.get("support", ""):
        decided.pop("support", None)
    say = show or partial(print, file=sys.stderr, flush=True)
    with hold_file(path):
        if path is not None and path.exists() and not overwrite:
            kept = _kept_layout(path, request, name, decided)
            say(f"{path} is there, for the same request and model: it is taken as it is")
            return kept
        log = None if path is None else path.with_suffix(".answers.json")
        found = ask_for_layout(
            request,
            answer,
            name,
            decided,
            timeout=timeout,
            max_tries=max_tries,
            show=say,
            log=log,
        )
        if path is None:
            return found
        write_atomically(path, found.text.encode())
        return replace(found, path=path)


def _kept_layout(path: Path, request: str, name: str, options: dict[str, Any]) -> AskedLayout:
    """The layout in a file, if it is for this request (ConfigError)."""
    from cluttergen_jax.generation.layout_ask import AskedLayout
    from cluttergen_jax.generation.layout_check import check_text
    from cluttergen_jax.generation.layouts import read_fields_of

    asked = read_fields_of(path).asked
    data = path.read_bytes()
    check = check_text(data, options)
    if asked is None or (asked.request, asked.model) != (request, name) or check.spec is None:
        raise ConfigError(
            f"{path} exists, with a layout of its own",
            "a new file, or that of the same request and model",
            "another `out`, or `overwrite`",
        )
    return AskedLayout(data.decode(), asked, check.spec, check.notes, path=path)
