"""How far one reads to follow one call: files of the package entered, and moves between them.

Follows `make_sampler(pool="dining", objects=..., method="drop")`, without imports: a move is a call of a
Python function in another file of the package, or the return from it.

    python -m studies.benchmarks.trace [--moves]
"""

import sys
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType

import cluttergen_jax as cg

PACKAGE = str(Path(cg.__file__).parent) + "/"
OBJECTS = ("mug", "bowl", "dinner_plate")


class Trace:
    """Counts of the package's files that run between `start` and `stop`."""

    def __init__(self) -> None:
        self.files: Counter[str] = Counter()
        self.moves: Counter[tuple[str, str]] = Counter()
        self.importing = 0
        self.stack: list[str] = ["(caller)"]

    def profile(self, frame: FrameType, event: str, _: object) -> None:
        """Follow calls and returns; what runs while a module is imported is no part of the call."""
        if event not in ("call", "return"):
            return
        code: CodeType = frame.f_code
        if not code.co_filename.startswith(PACKAGE):
            return
        if code.co_name == "<module>":
            self.importing += 1 if event == "call" else -1
            return
        if self.importing:
            return
        file = code.co_filename.removeprefix(PACKAGE)
        if event == "call":
            self.files[file] += 1
            self.stack.append(file)
            before = self.stack[-2]
        else:
            before = self.stack.pop()
            file = self.stack[-1]
        if before != file:
            self.moves[before, file] += 1


def run() -> Trace:
    """The trace of making a sampler."""
    trace = Trace()
    sys.setprofile(trace.profile)
    try:
        cg.make_sampler(pool="dining", objects=OBJECTS, num_objects=3, method="drop")
    finally:
        sys.setprofile(None)
    return trace


if __name__ == "__main__":
    trace = run()
    print(f"{len(trace.files)} files, {sum(trace.moves.values())} moves between files")
    if "--moves" in sys.argv[1:]:
        for file, calls in trace.files.most_common():
            print(f"{calls:6}  {file}")
        for (source, target), calls in trace.moves.most_common(60):
            print(f"{calls:6}  {source} -> {target}")
