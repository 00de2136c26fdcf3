"""Gymnax: its registry and its wrappers, over random play."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
from gymnax.environments import spaces
from gymnax.wrappers import (
    FlattenObservationWrapper,
    GymnaxToDmEnvWrapper,
    GymnaxToGymWrapper,
    GymnaxToVectorGymWrapper,
    LegacyStepAPIWrapper,
    LogWrapper,
    StickyActionWrapper,
)
from random_play import random_score
from score import leave, now, record

from iphyre_jax.adapters import register_gymnax

ID = "iphyre/on-the-fly-support-v1"
WORLDS, STEPS = 16, 160  # longer than an episode


def scan(env: Any, params: Any) -> Any:
    """Play random actions in a batch within one scan, and return the steps."""

    def act(state: Any, key: jax.Array) -> Any:
        own = jax.random.split(key, 2 * WORLDS)
        actions = jax.vmap(env.action_space(params).sample)(own[:WORLDS])
        out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(own[WORLDS:], state, actions, params)
        return out[1], (out[0], *out[2:])

    obs, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(jax.random.key(0), WORLDS), params)
    steps = jax.jit(lambda state, keys: jax.lax.scan(act, state, keys)[1])(
        state, jax.random.split(jax.random.key(1), STEPS)
    )
    assert steps[0].shape[1:] == obs.shape
    assert bool((steps[2] | steps[3] if len(steps) == 5 else steps[2]).any())
    return steps


def log() -> None:
    """Returns and lengths of episodes, as the wrapper counts them."""
    env, params = gymnax.make(ID)
    info = scan(LogWrapper(FlattenObservationWrapper(env)), params)[-1]
    ended = np.asarray(info["returned_episode"])
    lengths = np.asarray(info["returned_episode_lengths"])[ended]
    assert ((lengths > 1) & (lengths <= params.max_steps_in_episode)).all()
    assert abs(np.asarray(info["returned_episode_returns"])[ended].mean() - random_score(ID).mean) < 200


def others() -> None:
    """Wrappers that keep the interface."""
    env, params = gymnax.make(ID)
    assert isinstance(env.action_space(params), spaces.Discrete)
    scan(StickyActionWrapper(env, 0.25), params)
    assert len(scan(LegacyStepAPIWrapper(env), params)) == 4
    five, params = gymnax.make(ID.replace("iphyre/", "iphyre-five/"))
    assert "final_observation" not in scan(five, params)[-1]


def other_interfaces() -> None:
    """Wrappers into gymnasium and dm_env."""
    env, params = gymnax.make(ID)
    for wrapped in (GymnaxToGymWrapper(env, params), GymnaxToVectorGymWrapper(env, 4, params)):
        wrapped.action_space.seed(0)
        wrapped.reset(seed=0)
        for _ in range(20):
            out = wrapped.step(wrapped.action_space.sample())
        assert np.isfinite(np.asarray(out[0])).all()
    steps = GymnaxToDmEnvWrapper(env)
    moment = steps.reset(jax.random.key(0), params)
    moment = steps.step(jax.random.key(0), moment, jnp.int32(1), params)
    assert abs(float(moment.reward) + 10.1) < 1e-4
    assert float(moment.discount) == 1.0


if __name__ == "__main__":
    register_gymnax()
    parts: dict[str, Callable[[], None]] = {
        "make, FlattenObservationWrapper, LogWrapper in a scan": log,
        "StickyActionWrapper, LegacyStepAPIWrapper in a scan": others,
        "GymnaxToGymWrapper, GymnaxToVectorGymWrapper, GymnaxToDmEnvWrapper": other_interfaces,
    }
    for number, (ran, run) in enumerate(parts.items()):
        start = now()
        run()
        record(f"gymnax-{number + 1}", "gymnax", ran, since=start)
    leave(True)
