"""Nouns of things, and what kind of thing each is: a part of WordNet 3.0, whose notice heads its file.

`studies/make_nouns.py` makes the file. A synset is written as word.n.number, as NLTK and many data sets do.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from functools import cache
from pathlib import Path

SYNSET = re.compile(r"[a-z0-9_'./-]+\.n\.\d\d")
"""A noun of WordNet as it is written."""
NOUNS_FILE = Path(__file__).with_name("nouns.tsv")


@dataclass(frozen=True, eq=False)
class Nouns:
    """Synsets and what is above them.

    Attributes:
      above: the hypernyms of each synset, as far as they are kept.
      senses: the synsets of each word, its most frequent sense first; words have spaces, not underscores.
    """

    above: dict[str, tuple[str, ...]]
    senses: dict[str, tuple[str, ...]]

    def hypernyms(self, synset: str) -> list[str]:
        """The synset itself and all above it, nearest first; only itself if it is not known."""
        found = {synset: None}
        pending = deque([synset])
        while pending:
            for each in self.above.get(pending.popleft(), ()):
                if each not in found:
                    found[each] = None
                    pending.append(each)
        return list(found)


@cache
def read_nouns() -> Nouns:
    """Those that come with the package."""
    above = {}
    numbered: dict[str, list[tuple[int, str]]] = {}
    for line in NOUNS_FILE.read_text("ascii").splitlines():
        if line.startswith("#"):
            continue
        synset, hypernyms, also = line.split("\t")
        above[synset] = tuple(hypernyms.split())
        for each in (synset, *also.split()):
            word, _, number = each.rsplit(".", 2)
            numbered.setdefault(word.replace("_", " "), []).append((int(number), synset))
    senses = {
        word: tuple(synset for _, synset in sorted(found)) for word, found in numbered.items()
    }
    return Nouns(above, senses)


def is_below(synset: str, label: str, above: str) -> bool:
    """Whether a thing is what a synset means: by its own synset, or by the end of its label."""
    nouns = read_nouns()
    if SYNSET.fullmatch(synset):
        return above in nouns.hypernyms(synset)
    words = re.sub(r"[_\-\d]+", " ", label).lower().split()
    ends = (" ".join(words[start:]) for start in range(len(words)))
    senses = next((nouns.senses[end] for end in ends if end in nouns.senses), ())
    return any(above in nouns.hypernyms(each) for each in senses)
