"""What decides the bits of a scene beside its recipe: keys, settings of JAX, and what programs are made for.

The seed of a bank means the same keys, and a key the same draws in 32 bits, whatever settings of JAX the
shell or the program around has. What cannot be chosen here, `bits_of_here` tells.
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cluttergen_jax.files import cache_home

if TYPE_CHECKING:
    from cluttergen_jax.types import Array

T = TypeVar("T")

OF_THIS_PACKAGE = {"JAX_ENABLE_X64": "0", "JAX_THREEFRY_PARTITIONABLE": "1"}
"""`own_settings` as environment variables, for a process that is the package's alone."""

_IMPLEMENTATION = "threefry2x32"
_LOW = 0xFFFFFFFF
_UNOPTIMIZED = "jax_disable_most_optimizations"
_LEVEL = "xla_backend_optimization_level"
"""Of LLVM, 3 by default."""
_OF_VECTORS = ("sse", "ssse", "avx", "fma", "f16c", "amx", "asimd", "sve", "vsx", "vx")
"""How features of a processor begin that decide in which order and how exactly numbers are added."""
_NO_MATTER = (
    "xla_dump",
    "xla_force_host_platform_device_count",
    "xla_gpu_cuda_data_dir",
    "xla_hlo_",
)
"""How flags of XLA begin that change no result."""


def new_key(seed: int | Array) -> Array:
    """The key of a seed, whatever JAX's default implementation and offset of seeds are.

    Args:
      seed: 0 to 4294967295; or an integer array without axes, which may be traced.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    words: Any
    if isinstance(seed, Integral):
        words = np.array([0, int(seed) & _LOW], np.uint32)
    else:
        low = jnp.asarray(seed).astype(jnp.uint32)
        words = jnp.stack([jnp.zeros_like(low), low])
    return jax.random.wrap_key_data(words, impl=_IMPLEMENTATION)


@contextmanager
def own_settings() -> Iterator[None]:
    """Within it JAX computes in 32 bits, and threefry draws as it does by default; in this thread alone."""
    import jax

    config: Any = jax.config
    with ExitStack() as changed:
        # Only what differs is changed: contexts that change nothing would make JAX trace anew.
        if config.jax_enable_x64:
            changed.enter_context(jax.enable_x64(False))
        if not config.jax_threefry_partitionable:
            changed.enter_context(jax.threefry_partitionable(True))
        yield


with_own_settings = own_settings()
"""A decorator: the function runs, or is traced, within `own_settings`."""


def program_folder() -> Path:
    """Where compiled programs are kept.

    A program is made for one kind of processor: machines that share a home have a folder for each kind.
    """
    lines = (
        Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    )
    kind = {line for line in lines if line.startswith(("model name", "flags", "Features"))}
    digest = hashlib.sha256("\n".join(sorted(kind) or [platform.processor()]).encode()).hexdigest()
    return cache_home() / "programs" / f"{platform.machine()}-{digest[:12]}"


@contextmanager
def kept_programs() -> Iterator[None]:
    """Within it JAX keeps on disk what it compiles, so that a later process need not.

    Nothing changes where the user has chosen a folder, or none (`JAX_COMPILATION_CACHE_DIR`). The setting is
    one of the process; at the end JAX has its own back.
    """
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    config: Any = jax.config
    if config.jax_compilation_cache_dir is not None:
        yield
        return
    ours = {
        "jax_compilation_cache_dir": str(program_folder()),
        # By itself it keeps what took a second; a call has dozens that together take longer.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
    }
    theirs = {name: getattr(config, name) for name in ours}
    try:
        for name, value in ours.items():
            config.update(name, value)
        # JAX looks at the folder once.
        compilation_cache.reset_cache()
        yield
    finally:
        for name, value in theirs.items():
            config.update(name, value)
        compilation_cache.reset_cache()


def compiler_options() -> dict[str, Any] | None:
    """Options of `jax.jit` with which a CPU's programs compile in a fifth less time and have the same bits.

    Nothing where there is an accelerator, or where a level is chosen: by XLA_FLAGS or `fast_compilation`.
    """
    import jax

    config: Any = jax.config
    is_chosen = _LEVEL in os.environ.get("XLA_FLAGS", "") or config.read(_UNOPTIMIZED)
    if is_chosen or jax.default_backend() != "cpu":
        return None
    return {_LEVEL: 2}


@contextmanager
def _kept_and_own() -> Iterator[None]:
    with own_settings(), kept_programs():
        yield


with_kept_programs = _kept_and_own()
"""A decorator for functions that compile and run by themselves: `own_settings` and `kept_programs`."""


@contextmanager
def fast_compilation(is_wanted: bool = True) -> Iterator[None]:
    """Within it XLA optimises hardly anything, for programs that take longer to compile than to run.

    The last bits of what they compute differ. At the end all programs of this process are forgotten, so that
    nothing later runs one of these.
    """
    import jax

    config: Any = jax.config
    if not is_wanted or config.read(_UNOPTIMIZED):
        yield
        return
    config.update(_UNOPTIMIZED, True)
    try:
        yield
    finally:
        config.update(_UNOPTIMIZED, False)
        jax.clear_caches()


def as_float32(tree: T) -> T:
    """A pytree with its float64 arrays as float32: what a program that computes in 64 bits hands over."""
    import jax
    import jax.numpy as jnp

    def narrow(leaf: Any) -> Any:
        return (
            jnp.asarray(leaf, jnp.float32) if getattr(leaf, "dtype", None) == jnp.float64 else leaf
        )

    return jax.tree.map(narrow, tree)


def bits_of_here() -> dict[str, str]:
    """What a program computes its last bits by, of this process.

    Two processes that tell the same compute the same scenes of the same recipe on a CPU.
    """
    import jax

    config: Any = jax.config
    # Settings that are the user's to choose.
    settings = {
        "default_matmul_precision": config.jax_default_matmul_precision,
        "disable_most_optimizations": config.read(_UNOPTIMIZED),
    }
    return {
        "jaxlib": version("jaxlib"),
        "device": jax.devices()[0].device_kind,
        "instructions": " ".join([platform.machine(), *_vector_features()]),
        "xla_flags": " ".join(_xla_flags(os.environ.get("XLA_FLAGS", ""))),
        "jax_settings": " ".join(f"{name}={value}" for name, value in settings.items() if value),
    }


def _vector_features() -> list[str]:
    """The processor's instructions for vectors and fused sums; none where the system does not tell."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.is_file() else []
    features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return sorted(
        {name for name in features.partition(":")[2].split() if name.startswith(_OF_VECTORS)}
    )


def _xla_flags(text: str) -> list[str]:
    """The flags that change results, sorted; of one that is given twice the last counts."""
    flags = {word.partition("=")[0].lstrip("-"): word for word in text.split()}
    return [flags[name] for name in sorted(flags) if not name.startswith(_NO_MATTER)]
