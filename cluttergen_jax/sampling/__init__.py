"""Whole episodes in compiled blocks: the engine room of `generate`, evaluation and the sampler."""

from cluttergen_jax.sampling.blocks import BLOCK_SIZE, BlockSampler

__all__ = ["BLOCK_SIZE", "BlockSampler"]
