"""A training loop in the manner of purejaxrl: on-the-fly agents, everything in one jitted scan.

    python examples/reinforce_loop.py

It shows how the environment plugs into such a loop (here with the policy gradient of REINFORCE and optax); it is no
tuned agent. Needs the extra `train`.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import optax

import iphyre_jax

ENVS, STEPS = 64, 32  # worlds side by side, decisions of each in an update


def make_train(game: str, updates: int, learning_rate: float = 1e-3) -> Any:  # noqa: ANN401
    """Return `train(key, params)`: the policy's weights and the mean reward of each update, (updates,)."""
    env, _ = iphyre_jax.make(f"on-the-fly/{game}-v1")
    size, optimiser = env.observation_space().shape[0], optax.adam(learning_rate)

    def logits(weights: dict[str, jax.Array], obs: jax.Array) -> jax.Array:
        return jnp.tanh(obs @ weights["in"]) @ weights["out"]

    def train(key: jax.Array, params: iphyre_jax.EnvParams) -> tuple[dict[str, jax.Array], jax.Array]:
        key, reset_key, weight_key = jax.random.split(key, 3)
        weights = {"in": jax.random.normal(weight_key, (size, 64)) * 0.1, "out": jnp.zeros((64, env.num_actions))}
        obs, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(reset_key, ENVS), params)

        def act(carry: Any, key: jax.Array) -> Any:  # noqa: ANN401
            weights, obs, state = carry
            action_key, step_key = jax.random.split(key)
            action = jax.random.categorical(action_key, logits(weights, obs))
            keys = jax.random.split(step_key, ENVS)
            next_obs, state, reward, terminated, truncated, _ = jax.vmap(env.step, in_axes=(0, 0, 0, None))(
                keys, state, action, params
            )
            return (weights, next_obs, state), (obs, action, reward, terminated | truncated)

        def update(carry: Any, key: jax.Array) -> Any:  # noqa: ANN401
            weights, moments, obs, state = carry
            (_, obs, state), batch = jax.lax.scan(act, (weights, obs, state), jax.random.split(key, STEPS))
            all_obs, actions, rewards, done = batch

            def backwards(total: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
                total = step[0] + jnp.where(step[1], 0.0, total)
                return total, total

            _, returns = jax.lax.scan(backwards, jnp.zeros(ENVS), (rewards / 100, done), reverse=True)
            advantage = returns - returns.mean()

            def loss(weights: dict[str, jax.Array]) -> jax.Array:
                chosen = jax.nn.log_softmax(logits(weights, all_obs))
                log_prob = jnp.take_along_axis(chosen, actions[..., None], axis=-1)[..., 0]
                return -(log_prob * advantage).mean()

            changes, moments = optimiser.update(jax.grad(loss)(weights), moments)
            weights = optax.apply_updates(weights, changes)
            return (weights, moments, obs, state), rewards.mean()

        start = weights, optimiser.init(weights), obs, state
        (weights, *_), rewards = jax.lax.scan(update, start, jax.random.split(key, updates))
        return weights, rewards

    return train


if __name__ == "__main__":
    _, games = iphyre_jax.make("on-the-fly/support-v1")
    _, rewards = jax.jit(make_train("support", updates=30))(jax.random.key(0), games)
    print("mean reward a decision, first and last five updates:", rewards[:5].mean(), rewards[-5:].mean())
