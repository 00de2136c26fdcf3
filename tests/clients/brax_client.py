"""Brax: its PPO and its SAC, with its own wrappers and its own evaluation."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from brax.training.agents.ppo import train as ppo
from brax.training.agents.sac import train as sac
from random_play import random_score
from score import Score, leave, now, record

from iphyre_jax.adapters import BraxEnv, mend_brax, register_gymnax

PLANS = "in-advance/support-v1"
EVALUATED = 512  # episodes

RUNS: dict[str, Callable[..., Any]] = {
    "ppo": partial(
        ppo.train,
        num_timesteps=51_200,
        num_envs=256,
        batch_size=128,
        num_minibatches=8,
        unroll_length=1,
        num_updates_per_batch=4,
        learning_rate=1e-3,
        normalize_observations=True,
    ),
    "sac": partial(
        sac.train,
        num_timesteps=8_192,
        num_envs=16,
        batch_size=256,
        min_replay_size=512,
        max_replay_size=16_384,
        grad_updates_per_step=4,
        learning_rate=1e-3,
    ),
}


def train(run: str) -> bool:
    """Train one agent and write its record; the score is that of brax's own last evaluation."""
    mend_brax()
    start, found = now(), []
    RUNS[run](
        environment=BraxEnv(PLANS),
        episode_length=150,
        num_evals=2,
        num_eval_envs=EVALUATED,
        deterministic_eval=False,
        reward_scaling=0.01,
        progress_fn=lambda _, metrics: found.append(metrics),
    )
    last = found[-1]
    error = float(last["eval/episode_reward_std"]) / EVALUATED**0.5
    score = Score(float(last["eval/episode_reward"]), error, EVALUATED)
    ran = f"{run.upper()}, {RUNS[run].keywords['num_timesteps']} decisions, {PLANS}"
    random = random_score(f"iphyre/{PLANS.replace('/', '-')}")
    return record(f"brax-{run}", "brax", ran, since=start, score=score, random=random)


if __name__ == "__main__":
    register_gymnax()
    results = [train(run) for run in sys.argv[1:] or RUNS]  # all of them, also after a failure
    leave(all(results))
