"""Episodes as learners see them: the ways to play agree with one another and with plans played on the host."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import load_scene, simulate_many
from iphyre_jax.envs.in_advance import play_plans
from iphyre_jax.train.collect import PlanRollout, PolicyOutput, StepRollout, rollout_collector
from iphyre_jax.train.scenes import training_scenes, variations
from iphyre_jax.train.settings.run import TrainConfig, preset

GAMES = ("hinder", "hole")  # of one topology
EPISODES = 8


def decided(action: jax.Array) -> PolicyOutput:
    nothing = jnp.zeros(action.shape[0])
    return PolicyOutput(action, action, nothing, nothing)


@pytest.fixture(scope="module")
def plans() -> np.ndarray:
    """(16, 6) instants, all different within a plan, so that none is lost."""
    rng = np.random.default_rng(3)
    return np.stack([rng.permutation(np.arange(1, 60))[:6] for _ in range(len(GAMES) * EPISODES)])


@pytest.fixture(scope="module")
def planned(plans: np.ndarray) -> np.ndarray:
    """Rewards of the plans on the host."""
    which = np.repeat(np.arange(len(GAMES)), EPISODES)
    return play_plans(GAMES, which, (plans / 150).astype(np.float32)).reward


def test_in_advance_is_one_decision(plans: np.ndarray, planned: np.ndarray) -> None:
    rollout = rollout_collector(TrainConfig(games=GAMES), GAMES)
    assert isinstance(rollout, PlanRollout)
    actions = jnp.asarray(plans / 150, jnp.float32)
    trajectory, played = rollout.collect(lambda *_: decided(actions), jax.random.key(0), EPISODES)
    np.testing.assert_array_equal(played.reward, planned)
    np.testing.assert_allclose(trajectory.reward[0], planned, rtol=1e-6)
    assert trajectory.obs.shape == (2, 16, 120)
    assert bool(trajectory.done.all())


@pytest.mark.slow
def test_combined_with_a_plan_that_never_changes_is_in_advance(plans: np.ndarray, planned: np.ndarray) -> None:
    """The strategy plans anew after each removal; planning the same again, it plays what the host plays.

    In scenes of one's own too: these are the games under other names.
    """
    rollout = rollout_collector(
        preset("ppo", "combined"), [replace(load_scene(game), name=f"my {game}") for game in GAMES]
    )
    assert isinstance(rollout, StepRollout)
    actions = jnp.asarray(plans / 150, jnp.float32)
    trajectory, played = rollout.collect(lambda *_: decided(actions), jax.random.key(0), EPISODES)
    np.testing.assert_allclose(played.reward, planned, atol=1e-6)
    total = np.where(trajectory.active, trajectory.reward, 0).sum(axis=0)
    np.testing.assert_allclose(total, planned, rtol=1e-5)
    decisions = np.asarray(trajectory.active).sum(axis=0)
    assert ((decisions >= played.eliminations) & (decisions <= played.eliminations + 1)).all()
    assert (np.asarray(trajectory.done).sum(axis=0) == 1).all()


@pytest.mark.slow
def test_on_the_fly_removals_are_a_plan(plans: np.ndarray) -> None:
    """Each block is removed at its frame, the first one too; the host plays the same removals as a plan."""
    frames = plans - 1
    rollout = rollout_collector(preset("ppo", "on-the-fly"), GAMES)
    count = iter(range(1000))

    def policy(key: jax.Array, obs: jax.Array, num_samples: int) -> PolicyOutput:
        due = frames == next(count)
        return decided(jnp.asarray(np.where(due.any(axis=1), due.argmax(axis=1) + 1, 0), jnp.int32))

    trajectory, played = rollout.collect(policy, jax.random.key(0), EPISODES)
    which = np.repeat(np.arange(len(GAMES)), EPISODES)
    blocks = np.array([len(load_scene(game).eliminable_blocks) for game in GAMES])[which]
    steps = np.where(np.arange(6) < blocks[:, None], frames, -1)
    host = simulate_many(GAMES, which, steps, fps=10, resets=2)
    np.testing.assert_allclose(played.reward, host.reward, atol=1e-9)
    np.testing.assert_array_equal(played.eliminations, host.eliminations)
    active = np.asarray(trajectory.active)
    np.testing.assert_array_equal(active.sum(axis=0), host.steps)
    np.testing.assert_allclose(np.where(active, trajectory.reward, 0).sum(axis=0), host.reward, rtol=1e-4)
    assert trajectory.obs.shape == (151, 16, 159)


def test_variations_take_the_place_of_games_by_seed_and_update() -> None:
    config = TrainConfig(games=("support",), variations=6, episodes_per_scene=128, seed=2)
    scenes, episodes = training_scenes(config, 5)
    assert (len(scenes), episodes) == (4, 32)
    assert scenes[0] == "support"
    again, _ = training_scenes(config, 5)
    added = [scene.n_objects for scene in variations("support", 40, 1, 2)]
    assert len(added) == 40 + 2  # 14 of each number
    assert set(added) == {load_scene("support").n_objects + extra for extra in range(3)}
    mine, others = ({scene.balls.tobytes() for scene in variations("support", 40, seed, 2)} for seed in (1, 2))
    assert len(mine) > 40 - 2
    assert not mine & others  # a layout is drawn before its added blocks
    other, _ = training_scenes(config, 6)
    assert list(scenes) == list(again)
    assert list(scenes) != list(other)
    assert training_scenes(TrainConfig(games=GAMES), 1) == (GAMES, 128)


def test_a_game_with_few_episodes_is_played_in_half_of_the_updates() -> None:
    config = TrainConfig(games=("support",), variations=6, episodes_per_scene=32)
    played = [training_scenes(config, update)[0] for update in range(40)]
    assert {len(scenes) for scenes in played} == {1}
    games = sum(scenes[0] == "support" for scenes in played)
    assert 10 < games < 30
    assert len({scene.name + str(scene.balls) for (scene,) in played if not isinstance(scene, str)}) > 3


def test_variations_that_are_refused_are_drawn_again() -> None:
    """One in a hundred of angle's is valid; none comes twice, and all differ from run seed to run seed."""
    found = [one.blocks.tobytes() for seed in (0, 1) for one in variations("angle", 20, seed)]
    assert len(found) == len(set(found)) == 40
