"""Readers under what a coverage-guided search finds (atheris, with libFuzzer behind it; extra `fuzz`).

`python -m tests.helpers.fuzz_guided READER [-max_total_time=60 and other options of libFuzzer]` begins with
a sound file and with what `tests/corpus` holds. What crashes a reader is kept there, and `test_fuzz.py`
tries it again each time.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from cluttergen_jax.errors import ConfigError, MissingExtraError

try:
    import atheris
except ImportError as error:
    raise MissingExtraError("fuzz", "a search guided by coverage") from error

# Only what is imported here is watched: the readers, not the engines.
with atheris.instrument_imports(include=["cluttergen_jax"]):
    from tests.helpers.fuzzing import CORPUS, READERS, Bench


def search(name: str, options: list[str]) -> None:
    """Looks for crashes of one reader until libFuzzer's options end it; does not return.

    Raises:
      ConfigError: there is no such reader.
    """
    if name not in READERS:
        raise ConfigError(f"reader {name!r}", ", ".join(READERS))
    folder = Path(tempfile.mkdtemp())
    bench = Bench(name, folder)
    seeds = folder / "seeds"
    finds = CORPUS / name
    seeds.mkdir()
    (seeds / "sound").write_bytes(bench.sound)
    for each in finds.glob("*"):
        (seeds / each.name).write_bytes(each.read_bytes())
    finds.mkdir(exist_ok=True)

    def try_out(data: bytes) -> None:
        bench.try_out(data if bench.reader.signed is None else bench.reader.signed(data))

    atheris.Setup([sys.argv[0], str(seeds), f"-artifact_prefix={finds}/", *options], try_out)
    atheris.Fuzz()


if __name__ == "__main__":
    search(sys.argv[1] if len(sys.argv) > 1 else "", sys.argv[2:])
