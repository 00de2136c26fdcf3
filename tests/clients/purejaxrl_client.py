"""PPO in the manner of PureJaxRL: gymnax.make, two wrappers, one jitted `train` of nested scans.

Written anew; what it shares with PureJaxRL's are the calls of gymnax, flax, distrax and optax, with five values of
`step`, batches by `vmap(env.step)`, and the infos of the whole run as the metric.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import distrax
import flax.linen as nn
import gymnax
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from flax.linen.initializers import orthogonal
from flax.training.train_state import TrainState
from gymnax.environments import spaces
from gymnax.wrappers.purerl import GymnaxWrapper
from random_play import random_score
from score import Score, leave, now, record

from iphyre_jax.adapters import register_gymnax

NAME = "iphyre-five/on-the-fly-hole-v1"
CONFIG = {
    "LR": 1e-3,
    "NUM_ENVS": 64,
    "NUM_STEPS": 64,
    "NUM_UPDATES": 100,
    "UPDATE_EPOCHS": 4,
    "NUM_MINIBATCHES": 4,
    "GAMMA": 0.999,
    "GAE_LAMBDA": 0.95,
    "CLIP_EPS": 0.2,
    "ENT_COEF": 0.01,
    "VF_COEF": 0.5,
    "MAX_GRAD_NORM": 0.5,
    "REWARD_SCALE": 0.01,
}


@struct.dataclass
class LogState:
    """The state below, and the return of the episode so far."""

    env_state: Any
    episode_return: jax.Array


class LogEpisodes(GymnaxWrapper):
    """Puts the return of an episode that ends into the info."""

    @partial(jax.jit, static_argnums=0)
    def reset(self, key: jax.Array, params: Any = None) -> tuple[jax.Array, LogState]:
        """Begin an episode."""
        obs, state = self._env.reset(key, params)
        return obs, LogState(state, jnp.float32(0))

    @partial(jax.jit, static_argnums=0)
    def step(self, key: jax.Array, state: LogState, action: jax.Array, params: Any = None) -> tuple[Any, ...]:
        """Play one decision."""
        obs, env_state, reward, done, info = self._env.step(key, state.env_state, action, params)
        total = state.episode_return + reward
        info["returned_episode"], info["returned_episode_returns"] = done, total
        return obs, LogState(env_state, jnp.where(done, 0.0, total)), reward, done, info


class ActorCritic(nn.Module):
    """Two towers of two layers."""

    actions: int

    @nn.compact
    def __call__(self, x: jax.Array) -> tuple[distrax.Categorical, jax.Array]:
        """Return the policy and the value."""

        def tower(out: int, scale: float) -> jax.Array:
            hidden = x
            for _ in range(2):
                hidden = nn.tanh(nn.Dense(64, kernel_init=orthogonal(np.sqrt(2)))(hidden))
            return nn.Dense(out, kernel_init=orthogonal(scale))(hidden)

        return distrax.Categorical(logits=tower(self.actions, 0.01)), tower(1, 1.0)[..., 0]


class Transition(NamedTuple):
    """One decision of every world."""

    done: jax.Array
    action: jax.Array
    value: jax.Array
    reward: jax.Array
    log_prob: jax.Array
    obs: jax.Array
    info: Any


def make_train(config: dict[str, Any]) -> Any:
    """Return `train(key)`, to be jitted as a whole."""
    env, env_params = gymnax.make(NAME)
    env = LogEpisodes(env)
    assert isinstance(env.observation_space(env_params), spaces.Box)
    network = ActorCritic(env.action_space(env_params).n)
    worlds = config["NUM_ENVS"]

    def train(key: jax.Array) -> dict[str, Any]:
        key, init_key, reset_key = jax.random.split(key, 3)
        weights = network.init(init_key, jnp.zeros(env.observation_space(env_params).shape))
        tx = optax.chain(optax.clip_by_global_norm(config["MAX_GRAD_NORM"]), optax.adam(config["LR"], eps=1e-5))
        train_state = TrainState.create(apply_fn=network.apply, params=weights, tx=tx)
        obs, env_state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(reset_key, worlds), env_params)

        def env_step(runner: Any, _: None) -> Any:
            train_state, env_state, obs, key = runner
            key, act_key, step_key = jax.random.split(key, 3)
            policy, value = network.apply(train_state.params, obs)
            action = policy.sample(seed=act_key)
            next_obs, env_state, reward, done, info = jax.vmap(env.step, in_axes=(0, 0, 0, None))(
                jax.random.split(step_key, worlds), env_state, action, env_params
            )
            reward = reward * config["REWARD_SCALE"]
            transition = Transition(done, action, value, reward, policy.log_prob(action), obs, info)
            return (train_state, env_state, next_obs, key), transition

        def advantages(steps: Transition, last_value: jax.Array) -> jax.Array:
            def backwards(carry: Any, step: Transition) -> Any:
                gae, next_value = carry
                goes_on = 1 - step.done
                delta = step.reward + config["GAMMA"] * next_value * goes_on - step.value
                gae = delta + config["GAMMA"] * config["GAE_LAMBDA"] * goes_on * gae
                return (gae, step.value), gae

            start = jnp.zeros_like(last_value), last_value
            return jax.lax.scan(backwards, start, steps, reverse=True)[1]

        def loss(weights: Any, batch: tuple[Transition, jax.Array]) -> jax.Array:
            steps, gae = batch
            policy, value = network.apply(weights, steps.obs)
            clip = config["CLIP_EPS"]
            value_loss = jnp.square(value - (gae + steps.value)).mean()
            ratio = jnp.exp(policy.log_prob(steps.action) - steps.log_prob)
            gae = (gae - gae.mean()) / (gae.std() + 1e-8)
            actor_loss = -jnp.minimum(ratio * gae, jnp.clip(ratio, 1 - clip, 1 + clip) * gae).mean()
            return actor_loss + config["VF_COEF"] * value_loss - config["ENT_COEF"] * policy.entropy().mean()

        def update(runner: Any, _: None) -> Any:
            runner, steps = jax.lax.scan(env_step, runner, None, config["NUM_STEPS"])
            train_state, env_state, obs, key = runner
            gae = advantages(steps, network.apply(train_state.params, obs)[1])

            def epoch(carry: Any, _: None) -> Any:
                train_state, key = carry
                key, own = jax.random.split(key)
                size = worlds * config["NUM_STEPS"]
                order = jax.random.permutation(own, size).reshape(config["NUM_MINIBATCHES"], -1)
                flat = jax.tree.map(lambda leaf: leaf.reshape(size, *leaf.shape[2:]), (steps, gae))

                def minibatch(train_state: TrainState, rows: jax.Array) -> tuple[TrainState, None]:
                    grads = jax.grad(loss)(train_state.params, jax.tree.map(lambda leaf: leaf[rows], flat))
                    return train_state.apply_gradients(grads=grads), None

                return (jax.lax.scan(minibatch, train_state, order)[0], key), None

            (train_state, key), _ = jax.lax.scan(epoch, (train_state, key), None, config["UPDATE_EPOCHS"])
            return (train_state, env_state, obs, key), steps.info

        runner, metric = jax.lax.scan(update, (train_state, env_state, obs, key), None, config["NUM_UPDATES"])
        return {"runner_state": runner, "metrics": metric}

    return train


if __name__ == "__main__":
    register_gymnax()
    start = now()
    out = jax.jit(make_train(CONFIG))(jax.random.PRNGKey(0))
    info = jax.tree.map(lambda leaf: np.asarray(leaf)[-10:], out["metrics"])  # of the last tenth
    assert "final_observation" not in info
    score = Score.of(info["returned_episode_returns"][info["returned_episode"]])
    decisions = CONFIG["NUM_ENVS"] * CONFIG["NUM_STEPS"] * CONFIG["NUM_UPDATES"]
    ran = f"PPO, {CONFIG['NUM_ENVS']} worlds, {decisions} decisions"
    leave(record("purejaxrl-ppo", "gymnax", f"{ran}, {NAME}", since=start, score=score, random=random_score(NAME)))
