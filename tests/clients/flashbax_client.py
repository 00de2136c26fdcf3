"""Flashbax: a small DQN in one scan, whose replay is its item buffer."""

from __future__ import annotations

from typing import Any

import flashbax
import gymnax
import jax
import jax.numpy as jnp
import numpy as np
import optax
from random_play import random_score
from score import Score, leave, now, record

from iphyre_jax.adapters import register_gymnax

NAME = "iphyre/on-the-fly-hole-v1"
WORLDS, DECISIONS, WARM, UPDATES = 64, 2000, 32, 8  # updates a decision
GAMMA, SCALE, TAU, HIDDEN = 0.999, 0.01, 0.01, 64


def main() -> bool:
    """Train, score the last episodes of the greedy policy with a little chance, write the record."""
    env, params = gymnax.make(NAME)
    actions = env.action_space(params).n
    size = env.observation_space(params).shape[0]
    buffer = flashbax.make_item_buffer(
        max_length=65_536, min_length=WARM * WORLDS, sample_batch_size=256, add_batches=True
    )
    optimiser = optax.adam(1e-3)

    def q_values(weights: Any, obs: jax.Array) -> jax.Array:
        hidden = jax.nn.relu(obs @ weights["in"] + weights["in_bias"])
        return jax.nn.relu(hidden @ weights["mid"]) @ weights["out"]

    def init(key: jax.Array) -> dict[str, jax.Array]:
        first, second, third = jax.random.split(key, 3)
        return {
            "in": jax.random.normal(first, (size, HIDDEN)) * size**-0.5,
            "in_bias": jnp.zeros(HIDDEN),
            "mid": jax.random.normal(second, (HIDDEN, HIDDEN)) * HIDDEN**-0.5,
            "out": jax.random.normal(third, (HIDDEN, actions)) * 0.01,
        }

    def loss(weights: Any, target: Any, batch: dict[str, jax.Array]) -> jax.Array:
        best = q_values(weights, batch["next_obs"]).argmax(-1)
        future = jnp.take_along_axis(q_values(target, batch["next_obs"]), best[:, None], -1)[:, 0]
        wanted = batch["reward"] + GAMMA * jnp.where(batch["done"], 0.0, future)
        chosen = jnp.take_along_axis(q_values(weights, batch["obs"]), batch["action"][:, None], -1)[:, 0]
        return optax.huber_loss(chosen, jax.lax.stop_gradient(wanted)).mean()

    def decision(carry: Any, number: jax.Array) -> Any:
        weights, target, moments, replay, state, obs, total, key = carry
        key, act_key, chance_key, step_key, sample_key = jax.random.split(key, 5)
        epsilon = jnp.maximum(0.02, 1.0 - number / (0.4 * DECISIONS))
        chance = jax.random.uniform(chance_key, (WORLDS,)) < epsilon
        guess = jax.random.randint(act_key, (WORLDS,), 0, actions)
        action = jnp.where(chance, guess, q_values(weights, obs).argmax(-1).astype(jnp.int32))
        next_obs, state, reward, terminated, truncated, info = jax.vmap(env.step, in_axes=(0, 0, 0, None))(
            jax.random.split(step_key, WORLDS), state, action, params
        )
        step = {
            "obs": obs,
            "action": action,
            "reward": reward * SCALE,
            "next_obs": info["final_observation"],
            "done": terminated | truncated,
        }
        replay = buffer.add(replay, step)

        def learn(learner: Any, key: jax.Array) -> tuple[Any, None]:
            weights, target, moments = learner
            grads = jax.grad(loss)(weights, target, buffer.sample(replay, key).experience)
            changes, moments = optimiser.update(grads, moments)
            weights = optax.apply_updates(weights, changes)
            return (weights, optax.incremental_update(weights, target, TAU), moments), None

        weights, target, moments = jax.lax.cond(
            buffer.can_sample(replay),
            lambda learner: jax.lax.scan(learn, learner, jax.random.split(sample_key, UPDATES))[0],
            lambda learner: learner,
            (weights, target, moments),
        )
        total = total + reward
        ended = step["done"]
        return (weights, target, moments, replay, state, next_obs, jnp.where(ended, 0.0, total), key), (total, ended)

    start = now()
    keys = jax.random.split(jax.random.key(0), 3)
    obs, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(keys[0], WORLDS), params)
    weights = init(keys[1])
    zero = jnp.float32(0)
    example = {"obs": obs[0], "action": jnp.int32(0), "reward": zero, "next_obs": obs[0], "done": jnp.bool_(False)}
    carry = weights, weights, optimiser.init(weights), buffer.init(example), state, obs, jnp.zeros(WORLDS), keys[2]
    total, ended = jax.jit(lambda carry: jax.lax.scan(decision, carry, jnp.arange(DECISIONS)))(carry)[1]
    last = slice(-DECISIONS // 5, None)
    score = Score.of(np.asarray(total)[last][np.asarray(ended)[last]])
    ran = f"DQN over its item buffer, {WORLDS} worlds, {WORLDS * DECISIONS} decisions, {NAME}"
    return record("flashbax-dqn", "flashbax", ran, since=start, score=score, random=random_score(NAME))


if __name__ == "__main__":
    register_gymnax()
    leave(main())
