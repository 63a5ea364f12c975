"""Trained policies as proposers."""

from cluttergen_jax.policies.policy import Policy, find_policy, list_policies, load_policy
from cluttergen_jax.policies.ranked import Ranked
from cluttergen_jax.policies.screened import Screened

__all__ = ["Policy", "Ranked", "Screened", "find_policy", "list_policies", "load_policy"]
