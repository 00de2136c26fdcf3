"""Gymnasium's own functions make the environments from ids alone, in every mode and in other processes."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RecordEpisodeStatistics

from iphyre_jax.adapters import GymnasiumEnv, GymnasiumVectorEnv, register_gymnasium

ID = "iphyre/on-the-fly-support-v1"
ALONE = f"""
import gymnasium
env = gymnasium.make("iphyre_jax.gym:{ID}", render_mode="rgb_array")
print(env.reset(seed=0)[0].shape, env.spec.id)
"""


@pytest.mark.slow
def test_an_id_is_known_to_a_process_that_imports_nothing_of_ours() -> None:
    done = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["(122,)", ID]


def _played(envs: gymnasium.vector.VectorEnv[Any, Any, Any]) -> list[Any]:
    """Three decisions, the second of which removes a block of every world."""
    envs.reset(seed=0)
    steps = [envs.step(np.full(2, action)) for action in (0, 1, 0)]
    envs.close()
    return [part for obs, rewards, terminated, truncated, _ in steps for part in (obs, rewards, terminated, truncated)]


@pytest.mark.parametrize("mode", [None, "vector_entry_point", "sync"])
def test_make_vec(mode: str | None) -> None:
    register_gymnasium()
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode)
    assert isinstance(envs, gymnasium.vector.SyncVectorEnv if mode == "sync" else GymnasiumVectorEnv)
    own = _played(GymnasiumVectorEnv("on-the-fly/support-v1", 2))
    for here, there in zip(_played(envs), own, strict=True):
        np.testing.assert_allclose(here, there, atol=1e-6)


def test_make_vec_takes_wrappers_and_arguments() -> None:
    register_gymnasium()
    envs = gymnasium.make_vec(
        ID, num_envs=2, vectorization_mode="sync", wrappers=[RecordEpisodeStatistics], observation="motion"
    )
    assert isinstance(envs, gymnasium.vector.SyncVectorEnv)
    assert all(isinstance(env, RecordEpisodeStatistics) for env in envs.envs)
    assert isinstance(envs.envs[0].unwrapped, GymnasiumEnv)
    assert envs.single_observation_space.shape == (159,)
    spec = gymnasium.envs.registration.EnvSpec.from_json(envs.envs[0].spec.to_json())  # its own wrappers included
    assert gymnasium.make(spec).reset(seed=0)[0].shape == (159,)
    envs.close()


@pytest.mark.slow
def test_make_vec_in_processes_that_are_spawned() -> None:
    register_gymnasium()
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="async", vector_kwargs={"context": "spawn"})
    own = _played(GymnasiumVectorEnv("on-the-fly/support-v1", 2))
    for here, there in zip(_played(envs), own, strict=True):
        np.testing.assert_allclose(here, there, atol=1e-6)


def test_human_rendering_is_gymnasiums_own() -> None:
    """Its wrapper needs the class's metadata, which a factory function would not have."""
    register_gymnasium()
    creator = gymnasium.envs.registration.load_env_creator(gymnasium.registry[ID].entry_point)
    assert creator.metadata["render_modes"] == ["rgb_array"]
