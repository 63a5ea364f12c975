"""The commands about layouts: their schema, what is wrong with one, and one from a sentence."""

from __future__ import annotations

import inspect
import json
from pathlib import Path, PurePosixPath
from typing import Annotated

from tyro.conf import Positional, arg

from cluttergen_jax.api.generate import generate
from cluttergen_jax.api.layout import ENDINGS, ask_layout, check_layout
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Group, Options, command


@command()
def show_schema() -> None:
    """Print the JSON schema of a layout; `cluttergen layout --schema` is the same.

    Example: `cluttergen layout schema`
    """
    from cluttergen_jax.generation.layout_check import layout_schema

    print(json.dumps(layout_schema(), indent=2))


@command(
    check_layout,
    layout=Positional[str],
    region=str | None,
    keep_out=tuple[str, ...],
    clutter=str | None,
    everyday="pool objects num_objects support region",
)
def find_errors(options: Options) -> int:
    """Find all that is wrong with a layout at once. Exit status 1 if something is.

    Example: `cluttergen layout check breakfast.yaml`
    """
    found = options.call(check_layout, only_changed=True, layout=options.layout)
    print(found)
    return 0 if found.is_sound else 1


@command(
    ask_layout,
    generate,
    request=Positional[str],
    num_scenes=Annotated[int, arg(aliases=["-n"])],
    model=str,
    out=str | None,
    region=str | None,
    keep_out=tuple[str, ...],
    clutter=str | None,
    needed=("request", "model"),
    left_out=("layout", *ask_layout.spec_refused),  # type: ignore[attr-defined]
    everyday="model pool support region num_scenes seed render out",
)
def ask(options: Options) -> None:
    """Have a language model write a layout for a sentence, check it, and make scenes of it.

    Its errors are sent back, four times at most. Rerun to resume.

    Example: `cluttergen layout ask "breakfast for two" --model "python my_model.py" --out breakfast`
    """
    out = options.out or "out"
    is_layout = Path(out).suffix in ENDINGS
    # Beside a bank that is stored elsewhere the layout is here.
    name = PurePosixPath(out).name if "://" in out else out.rstrip("/")
    path = out if is_layout else f"{name}.yaml"
    given = {"request": options.request, "model": options.model, "out": path}
    others = () if is_layout else tuple(inspect.signature(generate).parameters)
    hint = "leaving it out, or for scenes a bank as --out"
    asked = options.call(
        ask_layout, f"with --out {out}", hint, ignored=others, only_changed=True, **given
    )
    print(asked)
    if is_layout:
        return
    taken = tuple(inspect.signature(ask_layout).parameters)
    bank = options.call(generate, ignored=taken, only_changed=True, layout=path, out=out)
    print(with_flags(str(bank), options))


run_layout = Group(
    """Layouts, what shall stand where: `layout ask`, `layout check`, and `layout --schema`.

    Example: `cluttergen layout ask "breakfast for two" --model "python my_model.py" --out breakfast`
    """,
    {"ask": ask, "check": find_errors, "schema": show_schema},
)
