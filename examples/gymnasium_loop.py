"""A loop over a vector environment of gymnasium: random plans on the basic split.

    python examples/gymnasium_loop.py

Needs the extra `gymnasium`.
"""

from __future__ import annotations

import gymnasium
import numpy as np

from iphyre_jax.adapters import register_gymnasium


def random_plans(name: str, worlds: int, rounds: int) -> tuple[float, float]:
    """Play random plans and return their mean reward and the share that solved the game."""
    register_gymnasium()
    envs = gymnasium.make_vec(name, num_envs=worlds)
    envs.action_space.seed(0)
    envs.reset(seed=0)
    rewards, solved = [], []
    for _ in range(rounds):
        _, reward, _, _, infos = envs.step(envs.action_space.sample())
        rewards.append(reward)
        solved.append(infos["final_info"]["success"])  # in advance, every step ends an episode
    envs.close()
    return float(np.mean(rewards)), float(np.mean(solved))


if __name__ == "__main__":
    reward, solved = random_plans("iphyre/in-advance-basic-v1", worlds=64, rounds=4)
    print(f"mean reward {reward:.1f}, solved {solved:.2f}")
