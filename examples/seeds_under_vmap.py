"""A sweep over seeds and learning rates under `jax.vmap`: several whole training runs in one program.

    python examples/seeds_under_vmap.py

The worlds of all runs are one batch. Needs the extra `train`.
"""

from __future__ import annotations

import jax
from reinforce_loop import make_train

import iphyre_jax


def sweep(game: str, seeds: int, updates: int) -> jax.Array:
    """Train once for each seed; return the mean reward of each update, (seeds, updates)."""
    _, params = iphyre_jax.make(f"on-the-fly/{game}-v1")
    runs = jax.vmap(make_train(game, updates), in_axes=(0, None))
    keys = jax.vmap(jax.random.key)(jax.numpy.arange(seeds))
    return jax.jit(runs)(keys, params)[1]


if __name__ == "__main__":
    rewards = sweep("support", seeds=4, updates=30)
    for seed, curve in enumerate(rewards):
        print(f"seed {seed}: mean reward a decision, last five updates: {curve[-5:].mean():.2f}")
