"""Stable-Baselines3: PPO, DQN and SAC by id, in one process and in several."""

from __future__ import annotations

import sys
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

from iphyre_jax.adapters import SB3VecEnv

EPISODES, CHANCE = 50, 512  # of an agent, of random play
SUPPORT, HOLE = (f"iphyre_jax.gym:iphyre/in-advance-{game}-v1" for game in ("support", "hole"))
TABLE = np.random.default_rng(0).uniform(0.0, 0.4, (64, 6)).astype(np.float32)  # plans of an agent that wants numbers


def hundredth(env: gymnasium.Env) -> gymnasium.Env:
    """Rewards of the size that the library's settings are made for."""
    return gymnasium.wrappers.TransformReward(env, lambda reward: reward / 100)


def symmetric(env: gymnasium.Env) -> gymnasium.Env:
    """Actions from -1 to 1, as the library wants them for its normal distributions."""
    return gymnasium.wrappers.RescaleAction(env, -1.0, 1.0)


def numbered(env: gymnasium.Env) -> gymnasium.Env:
    """Actions that are rows of a table."""
    return gymnasium.wrappers.TransformAction(env, TABLE.__getitem__, gymnasium.spaces.Discrete(len(TABLE)))


def ppo(envs: VecEnv) -> BaseAlgorithm:
    """Return the library's PPO."""
    return PPO("MlpPolicy", envs, n_steps=512 // envs.num_envs, learning_rate=1e-3, seed=0, device="cpu")


def dqn(envs: VecEnv) -> BaseAlgorithm:
    """Return the library's DQN."""
    settings = {"learning_rate": 1e-3, "learning_starts": 200, "exploration_fraction": 0.6, "gradient_steps": 4}
    return DQN("MlpPolicy", envs, **settings, target_update_interval=200, seed=0, device="cpu")


def sac(envs: VecEnv) -> BaseAlgorithm:
    """Return the library's SAC."""
    return SAC("MlpPolicy", envs, learning_starts=200, batch_size=128, seed=0, device="cpu")


def vector(name: str, count: int) -> SB3VecEnv:
    """Return many worlds that play in one call, with rewards and actions as for the others."""
    envs = gymnasium.wrappers.vector.RescaleAction(gymnasium.make_vec(name, num_envs=count), -1.0, 1.0)
    return SB3VecEnv(gymnasium.wrappers.vector.TransformReward(envs, lambda reward: reward / 100))


def check_same(name: str, count: int, steps: int) -> None:
    """Play the worlds of `vector` beside the library's own, with the same seeds and actions; all must be alike."""
    ours, theirs = vector(name, count), DummyVecEnv([lambda: hundredth(symmetric(gymnasium.make(name)))] * count)
    for envs in (ours, theirs):
        envs.seed(3)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    generator, ended = np.random.default_rng(0), 0
    for _ in range(steps):
        actions = generator.uniform(-1, 1, (count, *ours.action_space.shape)).astype(np.float32)
        here, there = ours.step(actions), theirs.step(actions)
        for one, other in zip(here[:3], there[:3], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6)
        for one, other, first, begun in zip(here[3], there[3], ours.reset_infos, theirs.reset_infos, strict=True):
            assert set(other) - {"episode"} <= set(one), (other, one)
            assert (one["success"], one["is_success"], one["game"]) == (
                other["success"],
                other["is_success"],
                other["game"],
            )
            assert one["TimeLimit.truncated"] == other["TimeLimit.truncated"] if "TimeLimit.truncated" in one else True
            assert first["game"] == begun["game"]
            if "terminal_observation" in other:
                ended += 1
                np.testing.assert_allclose(one["terminal_observation"], other["terminal_observation"], atol=1e-6)
    assert ended > count


Wrapper = Callable[[gymnasium.Env], gymnasium.Env]
Run = tuple[Callable[[VecEnv], BaseAlgorithm], Wrapper, str, type[VecEnv], int, int]
RUNS: dict[str, Run] = {  # the last two are worlds and decisions
    "ppo-dummy": (ppo, symmetric, SUPPORT, DummyVecEnv, 8, 8_192),
    "ppo-subproc": (ppo, symmetric, SUPPORT, SubprocVecEnv, 2, 8_192),
    "ppo-vector": (ppo, symmetric, SUPPORT, SB3VecEnv, 8, 8_192),
    "dqn-dummy": (dqn, numbered, HOLE, DummyVecEnv, 4, 4_000),
    "dqn-subproc": (dqn, numbered, HOLE, SubprocVecEnv, 2, 4_000),
    "sac-dummy": (sac, symmetric, SUPPORT, DummyVecEnv, 1, 1_500),
    "sac-subproc": (sac, symmetric, SUPPORT, SubprocVecEnv, 2, 1_500),
}


def random_score(name: str) -> Score:
    """Return the score of random actions: the first episode of each of many worlds."""
    envs = gymnasium.make_vec(name, num_envs=CHANCE)
    envs.action_space.seed(0)
    envs.reset(seed=0)
    totals, over = np.zeros(CHANCE), np.zeros(CHANCE, bool)
    while not over.all():
        _, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
        totals += np.where(over, 0.0, rewards)
        over |= terminated | truncated
    envs.close()
    return Score.of(totals)


def train(run: str, random: dict[str, Score]) -> bool:
    """Train one agent and write its record."""
    make_agent, wrap, name, kind, count, decisions = RUNS[run]
    start = now()
    envs: Any
    if kind is SB3VecEnv:
        envs = vector(name, count)
        envs.seed(0)
    else:
        envs = make_vec_env(
            name, n_envs=count, seed=0, vec_env_cls=kind, wrapper_class=lambda env: hundredth(wrap(env))
        )
    agent = make_agent(envs)
    agent.learn(decisions)
    envs.close()
    alone = Monitor(wrap(gymnasium.make(name)))
    rewards, _ = evaluate_policy(agent, alone, EPISODES, deterministic=False, return_episode_rewards=True)
    on = f"a table of {len(TABLE)} plans" if wrap is numbered else "actions from -1 to 1"
    ran = f"{run.partition('-')[0].upper()}, {kind.__name__} of {count}, {agent.num_timesteps} decisions, {on}, {name}"
    scores = {"score": Score.of(rewards), "random": random[name]}
    return record(f"stable-baselines3-{run}", "stable-baselines3", ran, since=start, **scores)


if __name__ == "__main__":
    torch.set_num_threads(1)
    np.random.seed(0)  # noqa: NPY002 - the library's own
    check_same(SUPPORT, 4, 20)
    chance = {name: random_score(name) for name in (SUPPORT, HOLE)}
    results = [train(run, chance) for run in sys.argv[1:] or RUNS]  # all of them, also after a failure
    leave(all(results))
