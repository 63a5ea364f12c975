"""The rollout engine: whole episodes in compiled blocks, for `generate`, evaluation and the sampler."""

from cluttergen_jax.placement.rollout.run import (
    BlockSampler,
    Rollout,
    blocks_of,
    sample_block,
    sample_blocks,
)
from cluttergen_jax.placement.scenes import BLOCK_SIZE

__all__ = ["BLOCK_SIZE", "BlockSampler", "Rollout", "blocks_of", "sample_block", "sample_blocks"]
