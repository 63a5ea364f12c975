"""The rollout engine: whole episodes in compiled blocks, for `generate`, evaluation and the sampler."""

from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.sampling.blocks import BlockSampler
from cluttergen_jax.sampling.run import Rollout, blocks_of, sample_blocks

__all__ = ["BLOCK_SIZE", "BlockSampler", "Rollout", "blocks_of", "sample_blocks"]
