"""Stable-Baselines3: PPO, DQN and SAC by id, in one process and in several."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from score import Score, leave, now, record
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

EPISODES = 50
FLY, PLANS = (f"iphyre_jax.gym:iphyre/{name}-v1" for name in ("on-the-fly-hole", "in-advance-support"))


def hundredth(env: gymnasium.Env) -> gymnasium.Env:
    """Rewards of the size that the library's settings are made for."""
    return gymnasium.wrappers.TransformReward(env, lambda reward: reward / 100)


def ppo(envs: VecEnv) -> BaseAlgorithm:
    """Return the library's PPO."""
    return PPO("MlpPolicy", envs, n_steps=512 // envs.num_envs, learning_rate=1e-3, seed=0, device="cpu")


def dqn(envs: VecEnv) -> BaseAlgorithm:
    """Return the library's DQN."""
    return DQN(
        "MlpPolicy",
        envs,
        learning_starts=1000,
        learning_rate=5e-4,
        exploration_fraction=0.5,
        gamma=0.999,
        seed=0,
        device="cpu",
    )


def sac(envs: VecEnv) -> BaseAlgorithm:
    """Return the library's SAC."""
    return SAC("MlpPolicy", envs, learning_starts=200, batch_size=128, seed=0, device="cpu")


RUNS: dict[str, tuple[Callable[[VecEnv], BaseAlgorithm], str, type[VecEnv], int, int]] = {  # with worlds and decisions
    "ppo-dummy": (ppo, PLANS, DummyVecEnv, 8, 8_192),
    "ppo-subproc": (ppo, PLANS, SubprocVecEnv, 2, 8_192),
    "dqn-dummy": (dqn, FLY, DummyVecEnv, 4, 20_000),
    "dqn-subproc": (dqn, FLY, SubprocVecEnv, 2, 20_000),
    "sac-dummy": (sac, PLANS, DummyVecEnv, 1, 2_000),
    "sac-subproc": (sac, PLANS, SubprocVecEnv, 2, 2_000),
}


def random_score(name: str) -> Score:
    """Return the score of random actions."""
    env = gymnasium.make(name)
    env.action_space.seed(0)
    rewards = []
    for episode in range(EPISODES):
        env.reset(seed=episode)
        total, done = 0.0, False
        while not done:
            _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            total, done = total + float(reward), terminated or truncated
        rewards.append(total)
    return Score.of(rewards)


def train(run: str, random: dict[str, Score]) -> bool:
    """Train one agent and write its record."""
    make_agent, name, kind, count, decisions = RUNS[run]
    start = now()
    envs: Any = make_vec_env(name, n_envs=count, seed=0, vec_env_cls=kind, wrapper_class=hundredth)
    agent = make_agent(envs)
    agent.learn(decisions)
    envs.close()
    rewards, _ = evaluate_policy(
        agent, Monitor(gymnasium.make(name)), EPISODES, deterministic=False, return_episode_rewards=True
    )
    ran = f"{run.partition('-')[0].upper()}, {kind.__name__} of {count}, {agent.num_timesteps} decisions, {name}"
    return record(
        f"stable-baselines3-{run}", "stable-baselines3", ran, since=start, score=Score.of(rewards), random=random[name]
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    np.random.seed(0)  # noqa: NPY002 - the library's own
    chance = {name: random_score(name) for name in (FLY, PLANS)}
    results = [train(run, chance) for run in RUNS]  # all of them, also after a failure
    leave(all(results))
