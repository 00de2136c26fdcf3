"""Stable-Baselines3's PPO on an environment by its id, in worker processes.

pip install stable-baselines3
python examples/stable_baselines3_loop.py
"""

from __future__ import annotations

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize


def train(name: str, worlds: int, decisions: int) -> tuple[float, float]:
    """Train an agent; return the mean reward of 20 episodes before and after."""
    envs = make_vec_env(name, n_envs=worlds, seed=0, vec_env_cls=SubprocVecEnv)
    normalised = VecNormalize(envs, norm_obs=False, gamma=1.0)  # rewards of hundreds of points learn badly
    agent = PPO("MlpPolicy", normalised, n_steps=256, learning_rate=1e-3, seed=0, device="cpu")
    before, _ = evaluate_policy(agent, envs, 20, deterministic=False)
    agent.learn(decisions)
    after, _ = evaluate_policy(agent, envs, 20, deterministic=False)
    envs.close()
    return float(before), float(after)


if __name__ == "__main__":  # the workers import this file
    before, after = train("iphyre_jax.gym:iphyre/in-advance-support-v1", worlds=2, decisions=8192)
    print(f"mean reward before {before:.1f}, after {after:.1f}")
