"""Methods of a user's own, as a user's module has them."""

import jax
import jax.numpy as jnp

REACH = 0.5


def near_middle(key, episode):
    """Within half of the region, at a height at which small objects do not touch the top."""
    draw = jax.random.uniform(key, (4,))
    return draw.at[:2].set(0.5 + REACH * (draw[:2] - 0.5)).at[2].set(0.1)


def at_rest(rules):
    """At the height at which the object rests."""

    def propose(key, episode):
        height = rules.body(episode).height / rules.height_range(episode)
        return jax.random.uniform(key, (4,)).at[2].set(height)

    return propose


class Weighted:
    """One that holds an array."""

    name = "weighted"
    takes = ("natural",)

    def __init__(self, middle):
        self.middle = middle

    def __call__(self, key, episode):
        return jnp.append(self.middle, 0.1 * jax.random.uniform(key, (2,)))


def short(key, episode):
    return jnp.zeros(3)


def failing(key, episode):
    return jnp.zeros(4) + episode.nothing


def unclear(*arguments):
    return arguments
