"""The physics engines by name, behind their interface (`host.Physics`)."""

from __future__ import annotations

import jax

from cluttergen_jax.config import StabilityConfig, check_engine
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics.host import Physics
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.log import silent_import
from cluttergen_jax.physics.native import NativePhysics


def make_physics(
    layout: Layout, config: StabilityConfig, engine: str = "auto", num_threads: int = 0
) -> Physics:
    """The engine called `engine` for one compiled world.

    Args:
      layout: the compiled world.
      config: when an object stands still.
      engine: "native" (MuJoCo's C engine), "warp" (MJX on an NVIDIA GPU, slowly on a CPU), "jax" (MJX in
        pure JAX, for few simple objects), or "auto": warp where JAX runs on an NVIDIA GPU, else native;
        native alone knows `config.robust_tilt`, and `config.both_detectors`: MJX has one detector.
      num_threads: threads of the native engine; 0 takes every core.

    Raises:
      ConfigError: unknown engine, or one that cannot tell what is robust.
      MissingExtraError: "warp" without Warp installed.
    """
    engine = engine_of(engine, config)
    if engine == "native":
        return NativePhysics(layout, config, num_threads)
    if config.robust_tilt:
        raise ConfigError(
            f"engine {engine!r} with robust",
            "native, for robust scenes",
            "engine='native', or robust=False",
        )
    # MJX takes a second to import, and only who asks for it pays.
    with silent_import():
        from cluttergen_jax.physics.mjx import MjxPhysics

    return MjxPhysics(layout, config, engine)


def engine_of(engine: str, config: StabilityConfig) -> str:
    """The engine that is meant: what "auto" stands for on this machine, and every other name itself.

    Raises:
      ConfigError: there is none of that name.
    """
    check_engine(engine)
    if engine != "auto":
        return engine
    is_gpu = jax.default_backend() == "gpu"
    return "warp" if is_gpu and not config.robust_tilt else "native"
