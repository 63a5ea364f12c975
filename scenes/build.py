"""Makes the embedded pools again: python scenes/build.py (a few minutes, the same bytes each time)."""

from pathlib import Path

from cluttergen_jax.assets.modeller.catalog import POOLS, make_shape
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.importing.solo_stability import measured_object

LICENCE = "Apache-2.0"


def built(family: str, pool: str) -> ObjectAsset:
    """A family's object of canonical proportions, measured."""
    asset = measured_object(make_shape(family))
    print(f"{pool}/{asset.name}: {len(asset.parts)} parts, solo {asset.quality.solo_rate}")
    return asset


if __name__ == "__main__":
    for name, families in POOLS.items():
        pool = Pool(name, tuple(built(family, name) for family in families), licence=LICENCE)
        write_pool(Path(__file__).parent / "pools" / name, pool, overwrite=True)
