"""Predictions as a part of observations: what they say, and trainings with them."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

import iphyre_jax
from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.models.world import compare, prediction, storage
from iphyre_jax.models.world.training import start
from iphyre_jax.observations.features import ROWS_SIZE
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import load_scene
from iphyre_jax.train import loop
from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.collect import PolicyOutput, Trajectory, rollout_collector
from iphyre_jax.train.observations import parts
from iphyre_jax.train.predictions import Perfect, open_prediction, with_prediction_sum
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig

GAMES = ("hole", "seesaw")
PLAIN = TrainConfig(
    strategy="on-the-fly",
    head="categorical",
    games=GAMES,
    fps=60,
    resets=1,
    updates=1,
    episodes_per_scene=2,
    sampled_episodes=1,
    learner=PPO(samples_per_update=32, minibatches=1, epochs=1, critic=True),
)


def nothing(key: jax.Array, obs: jax.Array, samples: int) -> PolicyOutput:
    """On the fly: does nothing."""
    del key, samples
    none = jnp.zeros(len(obs))
    return PolicyOutput(none.astype(jnp.int32), none, none, none)


def played(config: TrainConfig) -> Trajectory:
    return rollout_collector(config, GAMES).collect(nothing, jax.random.key(0), 1)[0]


def test_the_perfect_prediction_is_the_next_table() -> None:
    plain, found = played(PLAIN), played(replace(PLAIN, prediction="perfect"))
    assert found.obs.shape[-1] == plain.obs.shape[-1] + ROWS_SIZE
    np.testing.assert_array_equal(found.obs[..., :-ROWS_SIZE], plain.obs)  # looking ahead changes nothing
    both = np.asarray(plain.active[:-1] & plain.active[1:])
    now, later = np.asarray(found.obs[:-2, :, -ROWS_SIZE:]), np.asarray(plain.obs[1:-1, :, :ROWS_SIZE])
    np.testing.assert_array_equal(now[both], later[both])
    assert not (now[both] == np.asarray(plain.obs[:-2, :, :ROWS_SIZE])[both]).all()


def test_the_perfect_prediction_is_one_in_either_backend() -> None:
    tables = []
    for backend in ("host", "xla"):
        options: dict[str, Any] = {"backend": backend, "observation": "motion", "autoreset": False}
        env, params = iphyre_jax.make("combined/fill-v1", **options)
        keys, action = jax.random.split(jax.random.key(0), 2), jnp.full((2, 6), 0.05)
        _, state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
        obs, state, *_ = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, state, action, params)
        perfect = Perfect()
        memory = perfect.start([load_scene("fill")], state.game, env, params)
        tables.append(perfect.predict(memory, obs, state)[0])
    np.testing.assert_array_equal(*tables)
    assert (tables[0] != obs[:, :ROWS_SIZE]).any()


def test_zeros_have_the_size_alone() -> None:
    found = played(replace(PLAIN, prediction="zeros", observation="motion"))
    assert parts(found.obs).motion.any()
    assert not parts(found.obs).predicted.any()
    assert parts(found.obs).predicted.shape[-1] == ROWS_SIZE


@pytest.mark.slow
def test_the_shipped_model_predicts_the_next_table() -> None:
    found = played(replace(PLAIN, prediction="objects-unlimited"))
    both = np.asarray(found.active[:-1] & found.active[1:])
    predicted, now, later = (
        np.asarray(part[both]) for part in (found.obs[:-2, :, -ROWS_SIZE:], found.obs[:-2], found.obs[1:-1])
    )
    now, later = now[:, :ROWS_SIZE], later[:, :ROWS_SIZE]
    moving = np.abs(now - later) > 1 / SCREEN
    assert np.abs(predicted - later)[moving].mean() < 0.1 * np.abs(now - later)[moving].mean()
    np.testing.assert_array_equal(predicted[now == 0], 0)


@pytest.mark.slow
@pytest.mark.further
@pytest.mark.parametrize("strategy", ["on-the-fly", "combined"])
def test_a_training_with_a_model_is_the_same_twice(strategy: StrategyName, tmp_path: Path) -> None:
    world = compare.row_settings("mdrnn-400")
    storage.RUNS.create(tmp_path / "model", world)
    storage.save(tmp_path / "model", world, start(world), [1.0])
    config = replace(PLAIN, strategy=strategy, prediction=str(tmp_path / "model"))
    if strategy == "combined":
        config = replace(config, head="time_grid", learner=PPO(samples_per_update=8, minibatches=1, epochs=1))
    runs = [loop.train(config, tmp_path / name, Console(quiet=True)) for name in ("one", "two")]
    leaves = [jax.tree.leaves(run.state.learner) for run in runs]
    assert all(np.array_equal(one, two) for one, two in zip(*leaves, strict=True))
    changed = replace(with_prediction_sum(config), prediction_sha256="0" * 64)
    with pytest.raises(ValueError, match="SHA-256 0000"):
        open_prediction(changed)


def test_networks_begin_with_room_for_a_prediction() -> None:
    config = replace(PLAIN, prediction="zeros")
    learner = init(config, jax.random.key(0))
    seen = played(config).obs[0]
    assert algorithm(config).greedy_policy(learner)(seen).shape == (len(GAMES),)


@pytest.mark.slow
def test_the_command_line_knows_world_models(tmp_path: Path) -> None:
    plain = ["train", "--agent", "ppo", "--strategy", "on-the-fly", "--fps", "60", "--head", "categorical"]
    command = [sys.executable, "-m", "iphyre_jax", *plain, "--prediction", "nothing"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "expected zeros, perfect, one of objects-unlimited" in " ".join(done.stderr.split())
    assert not any(tmp_path.iterdir())  # a run that is refused leaves no folder


def test_a_world_model_needs_its_rate() -> None:
    with pytest.raises(ValueError, match="fps: expected 60 with a world model"):
        replace(PLAIN, fps=10, prediction="objects-unlimited").check()
    replace(PLAIN, fps=10, prediction="perfect").check()


def test_a_model_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^prediction: expected zeros, perfect, one of objects-unlimited, or"):
        prediction.read_prediction("nothing")
