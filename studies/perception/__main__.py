"""`python -m studies.perception`: views, a segmenter, and how well objects and their poses are found."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from tyro.conf import Positional

from cluttergen_jax.cli.main import program, run_words
from cluttergen_jax.cli.options import Group, Options, command
from studies.perception.api import perception_data, perception_eval, perception_train


@command(perception_data)
def make_views(options: Options) -> None:
    """Render views of scenes to train and judge perception with. Rerun to resume.

    Example: `python -m studies.perception data --pool household --num-views 6000 --out views`
    """
    views = options.call(perception_data)
    for split in views.splits:
        print(f"views      {views.split(split)['num_views']} of {split} in {views.path}")


@command(perception_train, data=Positional[str])
def train_segmenter(options: Options) -> None:
    """Train a segmenter on views. Rerun to resume.

    Example: `python -m studies.perception train views --out runs/segmenter`
    """
    options.call(perception_train)


@command(perception_eval, data=Positional[str])
def judge_perception(options: Options) -> None:
    """Judge masks, poses and certainty against what is true (extra `perception`).

    Every row is kept in the folder `--out`: rerun to resume.

    Example: `python -m studies.perception eval views --segmenter runs/segmenter`
    """
    print(options.call(perception_eval, out=options.out or "out/perception"))


COMMANDS = Group(
    """Known objects in images: `data`, `train` and `eval`.

    Example: `python -m studies.perception data --num-views 6000 --out views`
    """,
    {"data": make_views, "train": train_segmenter, "eval": judge_perception},
)


def main(words: Sequence[str]) -> int:
    """Parses the words of a command line and runs what they ask for; the exit status."""
    return run_words(lambda: COMMANDS.options, "python -m studies.perception", words)


if __name__ == "__main__":
    program(sys.argv[1:], main)
