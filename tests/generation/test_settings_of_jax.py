"""Settings of JAX that a shell or a program has decide no scene: not its draws, not the width of numbers."""

import json
import os
import subprocess
import sys
from contextlib import suppress

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.numerics import (
    bits_of_here,
    compiler_options,
    fast_compilation,
    kept_programs,
    new_key,
    program_folder,
)
from cluttergen_jax.scene.bank import read_bank

BASELINES = ("random", "clear", "drop", "spread", "guided")
HOSTILE = {
    "JAX_ENABLE_X64": "1",
    "JAX_THREEFRY_PARTITIONABLE": "0",
    "JAX_DEFAULT_PRNG_IMPL": "rbg",
    "JAX_RANDOM_SEED_OFFSET": "7",
}


def elsewhere(*words):
    """What a program with other settings of JAX prints."""
    done = subprocess.run(
        [sys.executable, "-m", *words],
        env=os.environ | HOSTILE,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1, 2**31, 2**32 - 1])
def test_a_seed_means_the_key_that_it_always_meant(seed):
    usual = jax.random.key(seed, impl="threefry2x32")
    key = jax.random.key_data(new_key(seed))
    np.testing.assert_array_equal(key, jax.random.key_data(usual))
    with jax.enable_x64(True):
        np.testing.assert_array_equal(jax.random.key_data(jax.jit(new_key)(jnp.uint32(seed))), key)


@pytest.mark.parametrize("method", BASELINES)
def test_every_method_is_the_same_program_whatever_is_set(pool, method):
    sample = cg.make_sampler(pool=pool, num_objects=1, method=method, num_threads=1)
    usual = str(jax.make_jaxpr(sample)(new_key(0)))
    with jax.enable_x64(True), jax.threefry_partitionable(False):
        assert str(jax.make_jaxpr(sample)(new_key(0))) == usual


@pytest.mark.parametrize("method", ["clear", pytest.param("guided", marks=pytest.mark.slow)])
def test_a_sampler_runs_where_all_is_set_otherwise(pool, method):
    assert set(json.loads(elsewhere("tests.helpers.sampled_elsewhere", pool, method))) == {method}


@pytest.mark.slow
def test_a_bank_is_the_same(pool, tmp_path):
    # The command, and the function in a program of 64 bits.
    settings = [
        "--pool",
        pool,
        "--num-objects",
        "2",
        "-n",
        "8",
        "--max-files",
        "0",
        "--method",
        "spread",
    ]
    elsewhere("cluttergen_jax", "generate", "--out", str(tmp_path / "command"), *settings)
    ours = cg.generate(
        tmp_path / "here", pool=pool, num_objects=2, num_scenes=8, max_files=0, method="spread"
    )
    with jax.enable_x64(True), jax.threefry_partitionable(False):
        wide = cg.generate(
            tmp_path / "wide", pool=pool, num_objects=2, num_scenes=8, max_files=0, method="spread"
        )
    rows = [rows_of(bank) for bank in (ours, wide, read_bank(tmp_path / "command"))]
    assert rows[0] == rows[1] == rows[2]


def rows_of(bank):
    """All that a bank's table says."""
    return [row for table in bank.tables() for row in table.to_pylist()]


def test_fast_compilation_is_told_and_ends_with_what_asked_for_it():
    double = jax.jit(lambda x: 2 * x)
    usual = bits_of_here()
    with fast_compilation(False):
        assert bits_of_here() == usual
    with suppress(KeyError), fast_compilation():
        assert "disable_most_optimizations=True" in bits_of_here()["jax_settings"]
        assert double(3) == 6
        raise KeyError
    assert bits_of_here() == usual
    assert double._cache_size() == 0, "a program that was compiled in between"


def test_programs_of_functions_are_kept_and_those_of_users_are_not(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path))
    folder = "jax_compilation_cache_dir"
    chosen = jax.config.jax_compilation_cache_dir
    num_kept = lambda: len(list(program_folder().glob("*"))) if program_folder().is_dir() else 0  # noqa: E731
    try:
        with kept_programs():
            jax.jit(lambda x: 3 * x)(1)
        assert num_kept() == 0, "where the user has chosen a folder, it is used"
        jax.config.update(folder, None)
        with suppress(KeyError), kept_programs():
            jax.jit(lambda x: 5 * x)(1)
            raise KeyError
        assert num_kept() > 0
        before = num_kept()
        jax.jit(lambda x: 7 * x)(1)
        assert (num_kept(), jax.config.jax_compilation_cache_dir) == (before, None)
    finally:
        jax.config.update(folder, chosen)


def test_programs_compile_quickly_unless_a_level_is_asked_for(monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    options = compiler_options()
    assert jax.jit(lambda x: x + 1, compiler_options=options)(1) == 2
    assert options == (
        None if jax.default_backend() != "cpu" else {"xla_backend_optimization_level": 2}
    )
    with fast_compilation():
        assert compiler_options() is None
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_optimization_level=0")
    assert compiler_options() is None
