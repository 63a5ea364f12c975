"""Trained policies as proposers."""

from cluttergen_jax.policies.policy import find_policy, list_policies, load_policy

__all__ = ["find_policy", "list_policies", "load_policy"]
