"""Types of what functions take and return, for annotations and `isinstance`."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.generation.bank import BankArrays
    from cluttergen_jax.generation.sampler import Sampler
    from cluttergen_jax.placement.replay import Replay
    from cluttergen_jax.placement.scenes import SceneBatch
    from cluttergen_jax.scene.bank.stats import BankStats
    from cluttergen_jax.spec import SceneOptions

__all__ = ["BankArrays", "BankStats", "Replay", "Sampler", "SceneBatch", "SceneOptions"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "BankArrays": "generation.bank:BankArrays",
        "BankStats": "scene.bank.stats:BankStats",
        "Replay": "placement.replay:Replay",
        "Sampler": "generation.sampler:Sampler",
        "SceneBatch": "placement.scenes:SceneBatch",
        "SceneOptions": "spec:SceneOptions",
    },
)
