"""Gymnasium: its checks, every way to make an environment, every wrapper that applies."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector
from score import leave, now, record

STRATEGIES = ("in-advance", "on-the-fly", "combined")
ID = "iphyre_jax.gym:iphyre/on-the-fly-support-v1"
PLANS = "iphyre_jax.gym:iphyre/in-advance-support-v1"
STEPS = 200

SINGLE: dict[str, Callable[[gymnasium.Env], gymnasium.Env]] = {
    "Autoreset": wrappers.Autoreset,
    "ClipReward": lambda env: wrappers.ClipReward(env, -1.0, 1.0),
    "DelayObservation": lambda env: wrappers.DelayObservation(env, 2),
    "DtypeObservation": lambda env: wrappers.DtypeObservation(env, np.float64),
    "FlattenObservation": wrappers.FlattenObservation,
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 3),
    "MaxAndSkipObservation": lambda env: wrappers.MaxAndSkipObservation(env, 2),
    "NormalizeObservation": wrappers.NormalizeObservation,
    "NormalizeReward": wrappers.NormalizeReward,
    "OrderEnforcing": wrappers.OrderEnforcing,
    "PassiveEnvChecker": wrappers.PassiveEnvChecker,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "RenderCollection": wrappers.RenderCollection,
    "StickyAction": lambda env: wrappers.StickyAction(env, 0.25),
    "TimeAwareObservation": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 150)),
    "TimeLimit": lambda env: wrappers.TimeLimit(env, 20),
    "TransformReward": lambda env: wrappers.TransformReward(env, lambda reward: reward / 100),
}
VECTOR: dict[str, Callable[[Any], Any]] = {
    "ClipReward": lambda env: vector.ClipReward(env, -1.0, 1.0),
    "DictInfoToList": vector.DictInfoToList,
    "DtypeObservation": lambda env: vector.DtypeObservation(env, np.float64),
    "FlattenObservation": vector.FlattenObservation,
    "NormalizeObservation": vector.NormalizeObservation,
    "NormalizeReward": vector.NormalizeReward,
    "RecordEpisodeStatistics": vector.RecordEpisodeStatistics,
    "TransformReward": lambda env: vector.TransformReward(env, lambda reward: reward / 100),
}
NEXT_STEP_ONLY = {"DtypeObservation", "FlattenObservation", "NormalizeObservation"}  # gymnasium refuses same step


def play(env: gymnasium.Env, steps: int = STEPS) -> None:
    """Play random actions; begin an episode where one ends, unless a wrapper does."""
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if (terminated or truncated) and not isinstance(env, wrappers.Autoreset):
            env.reset()
    env.close()


def play_vector(envs: Any, steps: int = STEPS // 4) -> None:
    """Play random actions in all worlds."""
    envs.action_space.seed(0)
    obs, _ = envs.reset(seed=0)
    for _ in range(steps):
        obs, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert obs.shape[0] == len(rewards) == len(terminated) == len(truncated) == envs.num_envs
        if envs.metadata["autoreset_mode"] == AutoresetMode.DISABLED and (terminated | truncated).any():
            envs.reset(options={"reset_mask": terminated | truncated})
    envs.close()


def check() -> None:
    """Gymnasium's own check, with warnings as errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for strategy in STRATEGIES:
            check_env(gymnasium.make(f"iphyre_jax.gym:iphyre/{strategy}-support-v1", render_mode="rgb_array").unwrapped)


def modes() -> None:
    """`make_vec` in its modes, and our own vector environment in gymnasium's modes of autoreset."""
    play_vector(gymnasium.make_vec(ID, num_envs=3, vectorization_mode="sync"))
    play_vector(gymnasium.make_vec(ID, 3, "sync", wrappers=[wrappers.RecordEpisodeStatistics]))
    play_vector(gymnasium.make_vec(ID, 2, "async", vector_kwargs={"context": "spawn"}))
    for mode in AutoresetMode:
        play_vector(gymnasium.make_vec(ID, 3, "vector_entry_point", autoreset_mode=mode))


def main() -> None:
    """Run everything and write a record of each part."""
    parts: dict[str, Callable[[], None]] = {
        "check_env of the three strategies, warnings as errors": check,
        "make_vec: sync, wrappers=, async (spawn), vector_entry_point in the three modes of autoreset": modes,
        f"make with {len(SINGLE)} wrappers: {', '.join(SINGLE)}": lambda: (
            [play(wrap(gymnasium.make(ID, render_mode="rgb_array"))) for wrap in SINGLE.values()] and None
        ),
        f"make_vec with {len(VECTOR)} wrappers: {', '.join(VECTOR)}": lambda: (
            [play_vector(wrap(gymnasium.make_vec(ID, 3, autoreset_mode="NextStep"))) for wrap in VECTOR.values()]
            and None
        ),
        "the same in same step": lambda: (
            [
                play_vector(wrap(gymnasium.make_vec(ID, 3)))
                for name, wrap in VECTOR.items()
                if name not in NEXT_STEP_ONLY
            ]
            and None
        ),
        "make with RescaleAction, ClipAction, TransformAction": lambda: play(
            wrappers.TransformAction(
                wrappers.ClipAction(wrappers.RescaleAction(gymnasium.make(PLANS), -1.0, 1.0)), lambda a: a, None
            )
        ),
    }
    for number, (ran, run) in enumerate(parts.items()):
        start = now()
        run()
        record(f"gymnasium-{number + 1}", "gymnasium", ran, since=start)
    leave(True)


if __name__ == "__main__":
    main()
