"""The `VecEnv` of Stable-Baselines3; `make test-clients` plays it beside the library's own and trains on it."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
from iphyre_jax.adapters import SB3VecEnv

HOLE = "iphyre_jax.gym:iphyre/in-advance-hole-v1"


def test_an_episode_that_ends_has_its_own_infos() -> None:
    envs = SB3VecEnv(gymnasium.make_vec(HOLE, num_envs=3))
    obs = envs.reset()
    assert [info["time"] for info in envs.reset_infos] == [0.0] * 3
    after, rewards, done, infos = envs.step(np.zeros((3, 6), np.float32))
    np.testing.assert_array_equal(after, obs)
    assert (rewards.dtype, rewards.tolist(), done.tolist()) == (np.float32, [-15.0] * 3, [True] * 3)
    assert [(info["time"], info["is_success"], info["TimeLimit.truncated"]) for info in infos] == [
        (15.0, False, False)
    ] * 3
    assert infos[0]["terminal_observation"].shape == obs.shape[1:]
    assert [info["time"] for info in envs.reset_infos] == [0.0] * 3
    assert envs.get_attr("num_envs", [0, 2]) == [3, 3]
    with pytest.raises(NotImplementedError, match=r"^set_attr: expected no attribute of single worlds, got 'x'$"):
        envs.set_attr("x", 1)


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_other_autoresets_are_refused(mode: str) -> None:
    with pytest.raises(ValueError, match=f"^envs: expected the autoreset_mode SameStep, got '{mode}'$"):
        SB3VecEnv(gymnasium.make_vec(HOLE, num_envs=3, autoreset_mode=mode))
    with pytest.raises(ValueError, match=r"^envs: expected a vector environment of gymnasium, got"):
        SB3VecEnv(gymnasium.make(HOLE))  # type: ignore[arg-type]
