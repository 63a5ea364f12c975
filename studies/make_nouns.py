"""Makes the nouns that `cluttergen_jax.assets.nouns` knows from the files of WordNet 3.0.

`python -m studies.make_nouns DICT` with the folder of `data.noun` and `index.noun`, as Debian's package
`wordnet-base` has them. Kept are the synsets at and below those of the table of sense and a few wide ones,
each with its hypernyms among them, and those of `_ALSO`: what no kind of thing is above is of no use.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

from cluttergen_jax.assets.nouns import NOUNS_FILE
from cluttergen_jax.assets.sense import read_sense

_WIDE = ("container.n.01", "implement.n.01", "article.n.02", "furnishing.n.02", "toiletry.n.01")
_ALSO = {"mug.n.04": "cup.n.01"}
"""Hypernyms that people expect and WordNet lacks: a mug is no cup there."""
_ENCODING = "ascii"


def make_nouns(folder: Path) -> str:
    """The text of the file: a comment with WordNet's licence, then a synset a line.

    Each line has the synset, its hypernyms, and the other names of it, all as word.n.number with the number
    of the sense of that word; the three are separated by tabs, several by spaces.
    """
    licence, synsets = _read_synsets(folder / "data.noun")
    numbers = _read_numbers(folder / "index.noun")

    def key(word: str, offset: str) -> str:
        return f"{word}.n.{numbers[word, offset]:02d}"

    name = {offset: key(words[0], offset) for offset, (words, _) in synsets.items()}
    below = defaultdict(list)
    for offset, (_, hypernyms) in synsets.items():
        for each in hypernyms:
            below[each].append(offset)
    offset_of = {each: offset for offset, each in name.items()}
    kept: set[str] = set()
    roots = {each for kind in read_sense().kinds.values() for each in kind.synsets} | {*_WIDE}
    pending = [offset_of[each] for each in sorted(roots)]
    while pending:
        offset = pending.pop()
        if offset not in kept:
            kept.add(offset)
            pending += below[offset]
    lines = [f"# {line}".rstrip() for line in licence]
    for offset in sorted(kept, key=name.__getitem__):
        words, hypernyms = synsets[offset]
        extra = [_ALSO[name[offset]]] if name[offset] in _ALSO else []
        above = " ".join([name[each] for each in hypernyms if each in kept] + extra)
        also = " ".join(key(word, offset) for word in words[1:])
        lines.append(f"{name[offset]}\t{above}\t{also}")
    return "\n".join(lines) + "\n"


def _read_synsets(path: Path) -> tuple[list[str], dict[str, tuple[list[str], list[str]]]]:
    """The licence at the file's head; and the words and hypernyms of each synset, by offset."""
    licence = []
    synsets = {}
    for line in path.read_text(_ENCODING).splitlines():
        if line.startswith("  "):
            licence.append(line[2:].partition(" ")[2])
            continue
        fields = line.partition(" | ")[0].split()
        num_words = int(fields[3], 16)
        words = [fields[4 + 2 * index].lower() for index in range(num_words)]
        pointers = fields[5 + 2 * num_words :]
        quads = [pointers[start : start + 4] for start in range(0, len(pointers), 4)]
        synsets[fields[0]] = (words, [each[1] for each in quads if each[0] in ("@", "@i")])
    return licence, synsets


def _read_numbers(path: Path) -> dict[tuple[str, str], int]:
    """The number of each sense of a word, by word and offset."""
    numbers = {}
    for line in path.read_text(_ENCODING).splitlines():
        if not line.startswith("  "):
            fields = line.split()
            for number, offset in enumerate(fields[-int(fields[2]) :], 1):
                numbers[fields[0], offset] = number
    return numbers


if __name__ == "__main__":
    NOUNS_FILE.write_text(make_nouns(Path(sys.argv[1])), _ENCODING)
