"""Jumanji: its own smoke tests, its wrappers, and a policy gradient in one scan over them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jumanji import specs
from jumanji.env import Environment
from jumanji.testing.env_not_smoke import check_env_does_not_smoke, check_env_specs_does_not_smoke
from jumanji.types import TimeStep
from jumanji.wrappers import AutoResetWrapper, JumanjiToDMEnvWrapper, JumanjiToGymWrapper, VmapWrapper
from score import Score, leave, now, record

from iphyre_jax.adapters import JumanjiEnv

FLY, PLANS = "on-the-fly/support-v1", "in-advance/support-v1"
WORLDS, UPDATES = 64, 150
DEVIATION = 0.4  # of a plan's numbers before the squashing


def interfaces() -> None:
    """Jumanji's own checks, and its wrappers into gymnasium and dm_env."""
    for name in (FLY, PLANS):
        env = JumanjiEnv(name)
        check_env_does_not_smoke(env)
        check_env_specs_does_not_smoke(env)
    assert np.isfinite(JumanjiEnv(FLY, observation="motion").observation_spec.generate_value()).all()
    gym = JumanjiToGymWrapper(JumanjiEnv(FLY))
    obs, _ = gym.reset(seed=0)
    assert gym.observation_space.contains(np.asarray(obs))
    assert abs(float(gym.step(1)[1]) + 10.1) < 1e-4
    steps = JumanjiToDMEnvWrapper(JumanjiEnv(PLANS))
    assert steps.reset().first()
    last = steps.step(np.zeros(6, np.float32))
    assert last.last()
    assert (float(last.reward), float(last.discount)) == (-15.0, 0.0)


def wrapped() -> Environment:
    """Return a batch of worlds that begin again by themselves, by jumanji's wrappers."""
    env = VmapWrapper(AutoResetWrapper(JumanjiEnv(PLANS), next_obs_in_extras=True))
    assert isinstance(env.action_spec, specs.BoundedArray)
    return env


def episodes(env: Environment, weights: dict[str, jax.Array], key: jax.Array, updates: int, rate: float) -> Any:
    """Learn for some updates of one decision of every world; the weights and the rewards, (updates, worlds)."""
    optimiser = optax.adam(rate)

    def log_prob(weights: dict[str, jax.Array], obs: jax.Array, raw: jax.Array) -> jax.Array:
        mean = jnp.tanh(obs @ weights["in"]) @ weights["out"]
        return -jnp.square((raw - mean) / DEVIATION).sum(-1) / 2

    def update(carry: Any, key: jax.Array) -> Any:
        weights, moments, state, obs = carry
        mean = jnp.tanh(obs @ weights["in"]) @ weights["out"]
        raw = mean + DEVIATION * jax.random.normal(key, mean.shape)
        state, moment = env.step(state, jax.nn.sigmoid(raw))
        step: TimeStep = moment
        advantage = (step.reward - step.reward.mean()) / (step.reward.std() + 1.0)
        grads = jax.grad(lambda weights: -(log_prob(weights, obs, raw) * advantage).mean())(weights)
        changes, moments = optimiser.update(grads, moments)
        return (optax.apply_updates(weights, changes), moments, state, step.observation), step.reward

    reset_key, key = jax.random.split(key)
    state, first = env.reset(jax.random.split(reset_key, WORLDS))
    carry = weights, optimiser.init(weights), state, first.observation
    carry, rewards = jax.lax.scan(update, carry, jax.random.split(key, updates))
    return carry[0], rewards


def main() -> bool:
    """Train, play the trained policy and one that chooses at random, write the record."""
    start, env = now(), wrapped()
    size = env.observation_spec.shape[0]
    start_weights = {"in": jax.random.normal(jax.random.key(1), (size, 32)) * size**-0.5, "out": jnp.zeros((32, 6))}
    train = jax.jit(lambda weights, key: episodes(env, weights, key, UPDATES, 0.03))
    weights, _ = train(start_weights, jax.random.PRNGKey(0))
    _, rewards = jax.jit(lambda weights, key: episodes(env, weights, key, 8, 0.0))(weights, jax.random.PRNGKey(2))

    def random(carry: Any, key: jax.Array) -> Any:
        state, moment = env.step(carry, jax.random.uniform(key, (WORLDS, 6)))
        return state, moment.reward

    state, _ = env.reset(jax.random.split(jax.random.PRNGKey(3), WORLDS))
    _, chance = jax.jit(lambda state, keys: jax.lax.scan(random, state, keys))(
        state, jax.random.split(jax.random.PRNGKey(4), 8)
    )
    ran = f"policy gradient over VmapWrapper(AutoResetWrapper), {WORLDS} worlds, {WORLDS * UPDATES} decisions, {PLANS}"
    return record("jumanji-reinforce", "jumanji", ran, since=start, score=Score.of(rewards), random=Score.of(chance))


if __name__ == "__main__":
    start = now()
    interfaces()
    record(
        "jumanji-1",
        "jumanji",
        "its smoke tests of environments; JumanjiToGymWrapper, JumanjiToDMEnvWrapper",
        since=start,
    )
    start = now()
    leave(main())
