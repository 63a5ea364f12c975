"""Whole episodes in compiled blocks: the engine room of `generate`, evaluation and the sampler."""

from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.sampling.blocks import BlockSampler
from cluttergen_jax.sampling.run import blocks_of, sample_blocks

__all__ = ["BLOCK_SIZE", "BlockSampler", "blocks_of", "sample_blocks"]
