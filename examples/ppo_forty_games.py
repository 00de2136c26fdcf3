"""PPO on all forty games in one file, in the manner of PureJaxRL: everything is one jitted scan.

    python examples/ppo_forty_games.py

The agent chooses all times in advance, so an episode is one decision and the mean reward of a game's own episodes is
the baseline. The settings are those of `iphyre-jax train --preset quick`, which has the same score if it trains on all
forty games. Needs the extra `train`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

import iphyre_jax

EPISODES, UPDATES = 128, 60  # of each game in an update
EPOCHS, MINIBATCHES = 4, 4
RATE, CLIP, ENTROPY, STD_FLOOR = 1e-3, 0.2, 0.01, 30.0  # points are the unit of the last
SLOTS, INSTANTS = 6, 150  # never, then 0.1, 0.2, ..., 14.9 s
NEVER, SCALE = 0.25, 4.0  # prior: probability of never, mean of the other times in s


class Policy(nn.Module):
    """From observations, (B, 120), to log-probabilities of the instants of each slot, (B, 6, 150)."""

    centre: Any  # of the observations: games look much alike, so only differences are shown

    @nn.compact
    def __call__(self, obs: jax.Array) -> jax.Array:
        """Return the log-probabilities."""
        x = 2.0 * (obs - self.centre)
        for _ in range(2):
            x = nn.tanh(nn.Dense(256, kernel_init=nn.initializers.orthogonal(2**0.5))(x))
        outputs = nn.Dense(SLOTS * INSTANTS, kernel_init=nn.initializers.orthogonal(0.01))(x)
        times = np.log1p(-NEVER) + jax.nn.log_softmax(-jnp.arange(1, INSTANTS) / 10 / SCALE)
        prior = jnp.concatenate([jnp.log(jnp.full(1, NEVER)), times])
        return jax.nn.log_softmax(outputs.reshape(-1, SLOTS, INSTANTS) + prior)


def actions_of(instants: jax.Array) -> jax.Array:
    """Return actions in [0, 1] for instants, (..., 6); of equal instants the later slots wait, as one block goes."""
    apart: list[jax.Array] = []
    for instant in jnp.moveaxis(instants, -1, 0):
        for _ in apart:
            instant = instant + ((instant > 0) & jnp.stack([instant == other for other in apart]).any(0))
        apart.append(instant)
    return jnp.stack(apart, -1) / INSTANTS


def make_train(
    games: str = "all", episodes: int = EPISODES, updates: int = UPDATES
) -> Callable[[jax.Array], tuple[Any, jax.Array]]:
    """Return `train(key)`: the policy's weights, and the rewards, (updates, games, episodes)."""
    env, params = iphyre_jax.make(f"in-advance/{games}-v1", autoreset=False)
    count = params.n_games
    first_obs, _ = jax.vmap(env.reset_to, in_axes=(0, None))(jnp.arange(count), params)
    policy = Policy(first_obs.mean(0))
    used = first_obs[:, -2 * SLOTS :].reshape(count, SLOTS, 2).any(-1)  # slots that stand for a block
    rate = optax.linear_schedule(RATE, 0.0, updates * EPOCHS * MINIBATCHES)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate, eps=1e-5))
    game = jnp.repeat(jnp.arange(count), episodes)

    def log_prob(table: jax.Array, game: jax.Array, instants: jax.Array) -> jax.Array:
        chosen = table[game[:, None], jnp.arange(SLOTS), instants]
        return jnp.where(used[game], chosen, 0.0).sum(-1)

    def loss(weights: Any, part: Any, bonus: jax.Array) -> jax.Array:  # noqa: ANN401
        table = policy.apply(weights, first_obs)
        ratio = jnp.exp(log_prob(table, part["game"], part["instants"]) - part["log_prob"])
        gain = jnp.minimum(ratio * part["advantage"], jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * part["advantage"])
        entropy = -(jnp.exp(table) * table).sum(-1)[used].mean()
        return -gain.mean() - bonus * entropy

    def update(carry: Any, step: tuple[jax.Array, jax.Array]) -> tuple[Any, jax.Array]:  # noqa: ANN401
        act_key, play_key, learn_key = jax.random.split(step[0], 3)
        table = policy.apply(carry[0], first_obs)
        instants = jax.random.categorical(act_key, table[game])
        _, state = jax.vmap(env.reset_to, in_axes=(0, None))(game, params)
        keys = jax.random.split(play_key, len(game))
        _, _, reward, _, _, _ = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, state, actions_of(instants), params)
        rewards = reward.reshape(count, episodes)
        away = rewards - rewards.mean(1, keepdims=True)
        advantage = (away / (rewards.std(1, keepdims=True) + STD_FLOOR)).reshape(-1)
        batch = {"game": game, "instants": instants, "advantage": advantage}
        batch["log_prob"] = log_prob(table, game, instants)

        def learn(carry: Any, rows: jax.Array) -> tuple[Any, None]:  # noqa: ANN401
            weights, moments = carry
            grads = jax.grad(loss)(weights, jax.tree.map(lambda leaf: leaf[rows], batch), ENTROPY * (1 - step[1]))
            changes, moments = optimiser.update(grads, moments)
            return (optax.apply_updates(weights, changes), moments), None

        orders = jax.vmap(lambda key: jax.random.permutation(key, len(game)))(jax.random.split(learn_key, EPOCHS))
        return jax.lax.scan(learn, carry, orders.reshape(EPOCHS * MINIBATCHES, -1))[0], rewards

    def train(key: jax.Array) -> tuple[Any, jax.Array]:
        init_key, key = jax.random.split(key)
        weights = policy.init(init_key, first_obs)
        steps = jax.random.split(key, updates), jnp.arange(updates) / updates
        (weights, _), rewards = jax.lax.scan(update, (weights, optimiser.init(weights)), steps)
        return weights, rewards

    return train


if __name__ == "__main__":
    _, rewards = jax.jit(make_train())(jax.random.key(0))
    print("mean reward of the first and the last update:", rewards[0].mean(), rewards[-1].mean())
