"""The physics engines by name, behind their interface (`host.Physics`)."""

from __future__ import annotations

import os

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
        pure JAX, for few simple objects), or "auto" (`engine_of`); native alone knows `config.robust_tilt`,
        and `config.both_detectors`: MJX has one detector.
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


def engine_of(
    engine: str, config: StabilityConfig, lanes: int | None = None, num_threads: int = 0
) -> str:
    """The engine that is meant: what "auto" stands for on this machine, and every other name itself.

    "auto" is warp where JAX runs on an NVIDIA GPU and scenes are not robust, unless so few are simulated side
    by side that the cores here are quicker; else native.

    Args:
      lanes: scenes side by side; None for many.
      num_threads: of the native engine; 0 takes every core.

    Raises:
      ConfigError: there is none of that name.
    """
    check_engine(engine)
    if engine != "auto":
        return engine
    if config.robust_tilt or not has_nvidia():
        return "native"
    if lanes is None:
        return "warp"
    return min(("warp", "native"), key=lambda each: step_seconds(each, lanes, num_threads))


def has_nvidia() -> bool:
    """Whether JAX runs on an NVIDIA GPU; a GPU of another maker runs JAX, but not Warp."""
    if jax.default_backend() != "gpu":
        return False
    return "rocm" not in jax.devices()[0].client.platform_version.lower()


# By `python -m studies.benchmarks.gpu` (reports/benchmarks.md): ten dining objects on an H100 and on one core
# of its Xeon. A step of few scenes takes a GPU as long as one of many.
_NATIVE_STEPS = 6_000
_WARP_STEPS = 850_000
_WARP_STEP_SECONDS = 0.0017


def step_seconds(engine: str, lanes: int, num_threads: int = 0) -> float:
    """Seconds that one step of ten objects takes in all of some scenes side by side, as was measured.

    Args:
      engine: "native", or "warp" on a large GPU.
      lanes: scenes side by side.
      num_threads: of the native engine; 0 takes every core.
    """
    if engine == "native":
        return lanes / (_NATIVE_STEPS * (num_threads or os.cpu_count() or 1))
    return max(_WARP_STEP_SECONDS, lanes / _WARP_STEPS)
