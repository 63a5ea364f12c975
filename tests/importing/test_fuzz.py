"""Readers under mutated bytes: only ClutterGenError may come out, whatever stands in a file."""

import json
import random
import resource
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cluttergen_jax.assets.object_files import read_object
from cluttergen_jax.assets.pool import read_pool
from cluttergen_jax.assets.support_file import read_support
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.scene.bank import read_bank
from tests.helpers.fuzzing import CORPUS, READERS, Bench, mutated

QUIET = pytest.mark.filterwarnings("ignore::RuntimeWarning")


@pytest.fixture(scope="module")
def benches(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    made = {}

    def bench(name):
        if name not in made:
            made[name] = Bench(name, folder)
        return made[name]

    return bench


@QUIET
@pytest.mark.parametrize("name", READERS)
@settings(
    max_examples=20,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_mutants_are_refused_or_read(benches, name, seed):
    bench = benches(name)
    bench.try_out(bench.mutant(seed))


SEALED = [name for name, reader in READERS.items() if reader.mark is not None]


def flip_bits(bench, number):
    """Any one bit: a file with a checksum is refused, or read as the very same value."""
    for seed in range(number):
        data = bench.flipped(seed)
        bench.file.write_bytes(data)
        try:
            assert bench.reader.read(bench.folder) == bench.value, seed
        except ClutterGenError:
            continue
        finally:
            bench.file.write_bytes(bench.sound)


@QUIET
@pytest.mark.parametrize("name", SEALED)
def test_no_flipped_bit_gives_another_value(benches, name):
    flip_bits(benches(name), 60)


@QUIET
@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_many_mutants_and_flipped_bits(benches, name):
    bench = benches(name)
    for seed in range(1000):
        bench.try_out(bench.mutant(seed))
    if name in SEALED:
        flip_bits(bench, 5000)


@QUIET
@pytest.mark.parametrize(
    "path", sorted(CORPUS.glob("*/*")), ids=lambda p: f"{p.parent.name}/{p.name}"
)
def test_what_once_crashed_a_reader_does_not_any_more(benches, path):
    benches(path.parent.name).try_out(path.read_bytes())


JSON_READERS = {
    "bank.json": read_bank,
    "object.json": read_object,
    "pool.json": read_pool,
    "support.json": read_support,
    "record.json": read_checkpoint,
}
anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


@pytest.mark.parametrize("name", JSON_READERS)
@settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    record=anything | st.dictionaries(st.sampled_from(["format", "objects", "recipe"]), anything)
)
def test_any_json_is_refused(tmp_path, name, record):
    (tmp_path / name).write_text(json.dumps(record))
    with pytest.raises(ClutterGenError):
        JSON_READERS[name](tmp_path)


@pytest.mark.parametrize("name", JSON_READERS)
@pytest.mark.parametrize(
    "data", [b"[" * 100_000, b'{"format": 1' + b', "a": {' * 50_000, b"\xff\xfe", b""]
)
def test_json_that_breaks_parsers_is_refused(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ClutterGenError):
        JSON_READERS[name](tmp_path)


def test_mutants_differ_and_repeat():
    data = b"pos 1.0 2.0 " * 20
    mutants = [mutated(data, random.Random(seed)) for seed in range(50)]
    assert mutants == [mutated(data, random.Random(seed)) for seed in range(50)]
    assert len({*mutants, data}) > 45


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bank_record_signed", "urdf"])
def test_the_guided_search_runs(name):
    pytest.importorskip("atheris", reason="needs the extra fuzz")
    # A child's peak memory begins with its parent's: libFuzzer's usual limit is put on top of that.
    limit = 2048 + resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    options = ["-max_total_time=10", "-seed=1", f"-rss_limit_mb={limit}"]
    words = [sys.executable, "-m", "tests.helpers.fuzz_guided", name, *options]
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=CORPUS.parent.parent
    )
    assert done.returncode == 0, done.stderr
    # It has found its way: inputs that reach new code were kept.
    assert done.stderr.count("NEW") > 3
