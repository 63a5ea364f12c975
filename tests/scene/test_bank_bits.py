"""A bank of one recipe has scenes of one kind: what else decides their last bits stands in its record."""

import pytest

from cluttergen_jax.errors import BankError
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.record import INDEX
from tests.helpers import banks

HERE = {"jaxlib": "1", "instructions": "x86_64 avx avx2 fma", "xla_flags": ""}
THERE = HERE | {"instructions": "x86_64 avx", "xla_flags": "--xla_backend_optimization_level=0"}


def begun(path, bits, num_scenes=300):
    """A bank of 300 scenes, the first 256 of them made."""
    with banks.writer(path, num_scenes, bits=bits) as writer:
        writer.write_block(0, banks.rows(0))
    return path


def test_a_bank_is_not_continued_with_other_bits(tmp_path):
    path = begun(tmp_path / "bank", HERE)
    before = (path / INDEX).read_bytes()
    with pytest.raises(BankError, match="allow_other_bits") as caught:
        banks.writer(path, 600, bits=THERE)
    assert "instructions (here nothing more, the bank avx2 fma)" in str(caught.value)
    assert "xla_flags (here --xla_backend_optimization_level=0, the bank nothing more)" in str(
        caught.value
    )
    assert (path / INDEX).read_bytes() == before


def test_a_mixture_is_one_by_leave(tmp_path):
    path = begun(tmp_path / "bank", HERE)
    with banks.writer(path, 300, bits=THERE, allow_other_bits=True) as writer:
        writer.write_block(1, banks.rows(1, 44))
    assert read_bank(path).record["bits"] == [HERE, THERE]
    # It is one now: either may go on with it.
    for bits in (HERE, THERE):
        banks.writer(path, 900, bits=bits).close()
    assert read_bank(path).record["bits"] == [HERE, THERE]
