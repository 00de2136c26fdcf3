"""Rejax: PPO, SAC and DQN with its own evaluation, through `gymnax.make`."""

from __future__ import annotations

import sys
from typing import Any

import gymnax
import jax
import numpy as np
import rejax
from random_play import random_score
from score import Score, leave, now, record

from iphyre_jax.adapters import register_gymnax

FLY, PLANS = (f"iphyre-five/{name}-v1" for name in ("on-the-fly-hole", "in-advance-support"))
SMALL = {"activation": "relu", "hidden_layer_sizes": (64, 64)}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "ppo": (
        PLANS,
        {
            "total_timesteps": 200_000,
            "eval_freq": 100_000,
            "num_envs": 256,
            "num_steps": 4,
            "num_minibatches": 8,
            "num_epochs": 8,
            "learning_rate": 1e-3,
            "normalize_rewards": True,
        },
    ),
    "sac": (
        PLANS,
        {
            "total_timesteps": 40_000,
            "eval_freq": 20_000,
            "num_envs": 16,
            "learning_rate": 1e-3,
            "fill_buffer": 1000,
            "normalize_rewards": True,
        },
    ),
    "dqn": (
        FLY,
        {
            "total_timesteps": 128_000,
            "eval_freq": 64_000,
            "num_envs": 64,
            "num_epochs": 8,
            "batch_size": 256,
            "buffer_size": 65_536,
            "fill_buffer": 2048,
            "gamma": 0.98,
            "learning_rate": 1e-3,
            "exploration_fraction": 0.4,
            "target_update_freq": 64,
            "polyak": 0.92,
            "normalize_rewards": True,
        },
    ),
}

OBSERVATION = {"ppo": "official", "sac": "official", "dqn": "motion"}


def train(run: str) -> bool:
    """Train one agent and write its record; the score is that of rejax's own last evaluation."""
    name, settings = RUNS[run]
    start = now()
    seen = OBSERVATION[run]  # a greedy agent that sees a still world alike at all times would wait for ever
    env, env_params = gymnax.make(name, observation=seen)
    agent = rejax.get_algo(run).create(env=env, env_params=env_params, skip_initial_evaluation=True, **settings)
    _, (_, returns) = jax.jit(agent.train)(jax.random.PRNGKey(0))
    score = Score.of(np.asarray(returns)[-1])
    ran = f"{run.upper()}, {settings['num_envs']} worlds, {settings['total_timesteps']} decisions"
    return record(
        f"rejax-{run}",
        "rejax",
        f"{ran}, {seen} observation, {name}",
        since=start,
        score=score,
        random=random_score(name),
    )


if __name__ == "__main__":
    register_gymnax()
    results = [train(run) for run in sys.argv[1:] or RUNS]  # all of them, also after a failure
    leave(all(results))
