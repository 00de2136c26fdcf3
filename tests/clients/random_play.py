"""The score of random actions in an environment of gymnax's registry."""

from __future__ import annotations

from functools import cache
from typing import Any

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
from score import Score

EPISODES = 512  # side by side


@cache
def random_score(name: str) -> Score:
    """Return the score of one episode in each of many worlds; steps have five values or six."""
    env, params = gymnax.make(name)

    def act(carry: Any, key: jax.Array) -> Any:
        state, total, over = carry
        own = jax.random.split(key, 2 * EPISODES)
        actions = jax.vmap(env.action_space(params).sample)(own[:EPISODES])
        out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(own[EPISODES:], state, actions, params)
        done = out[3] | out[4] if len(out) == 6 else out[3]
        return (out[1], total + jnp.where(over, 0.0, out[2]), over | done), None

    keys = jax.random.split(jax.random.key(0), params.max_steps_in_episode)
    _, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(jax.random.key(1), EPISODES), params)
    start = state, jnp.zeros(EPISODES), jnp.zeros(EPISODES, bool)
    (_, total, over), _ = jax.jit(lambda start, keys: jax.lax.scan(act, start, keys))(start, keys)
    assert bool(over.all()), "an episode is longer than the parameters say"
    return Score.of(np.asarray(total))
