"""The loops of examples/ run."""

from __future__ import annotations

import runpy
from pathlib import Path

import jax
import numpy as np

from iphyre_jax import make

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_loop_of_jax() -> None:
    example = runpy.run_path(str(EXAMPLES / "ppo_loop.py"))
    _, params = make("on-the-fly/support-v1")
    with jax.numpy_rank_promotion("allow"):
        weights, rewards = jax.jit(example["make_train"]("support", updates=3))(jax.random.key(0), params)
    assert rewards.shape == (3,)
    assert np.isfinite(rewards).all()
    assert np.isfinite(weights["out"]).all()
    assert np.abs(weights["out"]).max() > 0


def test_the_loop_of_gymnasium() -> None:
    example = runpy.run_path(str(EXAMPLES / "gymnasium_loop.py"))
    reward, solved = example["random_plans"]("iphyre/in-advance-hole-v1", worlds=8, rounds=2)
    assert -100 < reward < 1000
    assert 0 <= solved <= 1
