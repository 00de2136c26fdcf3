"""Observations by hand, the in-advance environment's actions, rewards and errors."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import GAMES, SPLITS, load_scene
from iphyre_jax.envs.in_advance import action_to_times, load_scenes, observation_table, play_plans
from iphyre_jax.observations.features import Pose, official_rows, row_inputs, scene_tables
from iphyre_jax.observations.official import object_rows, observation, scene_features, start_observation
from iphyre_jax.rules import episode_reward
from iphyre_jax.scenes.compile import compile_scene
from iphyre_jax.train.observations import slot_mask

STILL = np.zeros(12)


def test_start_of_support_by_hand() -> None:
    """Two eliminable bars and a ball of radius 20; all lengths over 600."""
    rows = [
        [200 / 600, 400 / 600, 300 / 600, 400 / 600, 10 / 600, 1, 0, 0, 0],
        [200 / 600, 500 / 600, 300 / 600, 500 / 600, 10 / 600, 1, 0, 0, 0],
        [250 / 600, 340 / 600, 250 / 600, 340 / 600, 20 / 600, 0, 1, 0, 0],
    ]
    expected = np.zeros(120)
    expected[:27] = np.ravel(rows)
    expected[108:112] = np.array([250, 400, 250, 500]) / 600
    obs = start_observation(load_scene("support"))
    assert obs.dtype == np.float32
    np.testing.assert_array_equal(obs, expected.astype(np.float32))


def test_joint_and_spring_columns() -> None:
    for game, column in (("pendulum", 7), ("spring", 8)):
        rows = start_observation(load_scene(game))[:108].reshape(12, 9)
        flags = np.zeros((12, 2))
        flags[[5, 6], column - 7] = 1  # the pair is block 5 and the ball, object 6
        np.testing.assert_array_equal(rows[:, 7:], flags)


def test_second_pair_is_numbered_two_and_moves_up_when_the_first_goes() -> None:
    scene = load_scene("multi_ball_pendulum")
    features = scene_features(scene)
    assert len(scene.joints) == 2
    before = object_rows(features, features.position, STILL, features.present)[:, 7]
    for number, pair in enumerate(scene.joints, start=1):
        np.testing.assert_array_equal(before[list(pair)], [number, number])
    gone = scene.joints[0][0]
    alive = features.present & (np.arange(12) != gone)
    after = object_rows(features, features.position, STILL, alive)[:, 7]
    np.testing.assert_array_equal(after[list(scene.joints[1])], [1, 1])
    assert after[scene.joints[0][1]] == 0


def test_removed_object_leaves_a_row_of_zeros_and_its_candidate() -> None:
    features = scene_features(load_scene("pendulum"))
    alive = features.present & (np.arange(12) != 5)
    obs = observation(features, features.position, STILL, alive)
    start = start_observation(load_scene("pendulum"))
    rows, start_rows = obs[:108].reshape(12, 9), start[:108].reshape(12, 9)
    np.testing.assert_array_equal(rows[5], np.zeros(9))
    np.testing.assert_array_equal(rows[:5], start_rows[:5])
    assert start_rows[6, 7] == 1  # the ball hung on the removed block's joint
    assert rows[6, 7] == 0
    np.testing.assert_array_equal(obs[108:], start[108:])


def test_a_turned_bar_and_clipping() -> None:
    """A bar that lay flat, upright after a quarter turn; what leaves the screen sits at its edge."""
    features = scene_features(load_scene("fill"))
    scene = load_scene("fill")
    bar = int(np.flatnonzero(scene.dynamic[: scene.n_blocks])[0])
    half = (scene.blocks[bar, 1] - scene.blocks[bar, 0]) / 2
    position, angle = features.position.copy(), np.zeros(12)
    position[bar], angle[bar] = [100.0, 200.0], np.pi / 2
    position[scene.n_blocks] = [-5.0, 700.0]
    rows = object_rows(features, position, angle, features.present)
    turned = np.array([-half[1], half[0]])
    expected = [*(position[bar] - turned), *(position[bar] + turned)]
    np.testing.assert_allclose(rows[bar, :4], expected, atol=1e-12)
    ball = observation(features, position, angle, features.present)[:108].reshape(12, 9)[scene.n_blocks]
    np.testing.assert_array_equal(ball[:4], [0, 1, 0, 1])


@pytest.mark.slow
def test_device_and_host_observe_alike() -> None:
    """Rows in JAX and in NumPy, of a whole scene and with each block gone."""
    scene = load_scene("multi_ball_spring")
    host, topology = scene_features(scene), compile_scene(scene)[0]
    angle, position = np.linspace(-1, 1, 12), host.position.copy()
    movers = np.flatnonzero(scene.dynamic)
    angle[~np.isin(np.arange(12), movers)] = 0.0
    position[movers] += 20.0
    features = jax.tree.map(jnp.asarray, scene_tables(scene, [topology], "float32"))
    for gone in (None, *scene.eliminable_blocks):
        present = host.present & (np.arange(12) != gone)
        x, y = jnp.asarray(position[movers].T, jnp.float32)
        pose = Pose(x, y, jnp.asarray(angle[movers], jnp.float32), jnp.asarray(present), jnp.ones((), bool))
        expected = observation(host, position, angle, present)[:108]
        np.testing.assert_allclose(official_rows(features, row_inputs(features, pose)), expected, atol=1e-6)


def test_table_of_all_games_is_in_the_box_and_masks_slots() -> None:
    table = observation_table(GAMES)
    assert table.shape == (40, 120)
    assert table.dtype == np.float32
    assert table.min() >= 0
    assert table.max() <= 1
    blocks = [len(load_scene(game).eliminable_blocks) for game in GAMES]
    np.testing.assert_array_equal(np.asarray(slot_mask(table)).sum(axis=1), blocks)
    np.testing.assert_array_equal(slot_mask(table), np.arange(6) < np.array(blocks)[:, None])


def test_reward_by_hand() -> None:
    success, eliminations, steps = np.array([True, False, True]), np.array([2, 1, 0]), np.array([24, 150, 60])
    np.testing.assert_allclose(episode_reward(success, eliminations, steps, 10), [977.6, -25.0, 994.0])
    np.testing.assert_allclose(episode_reward(success[2:], eliminations[2:], steps[2:], 60), [999.0])


def test_action_is_a_share_of_fifteen_seconds() -> None:
    actions = np.array([[0, 1 / 3, 1, 0.5, 0.02, 0.1]], np.float32)
    times = action_to_times(actions)
    assert times.dtype == np.float32
    np.testing.assert_array_equal(times, actions * np.float32(15))
    assert action_to_times(actions.astype(np.float64)).dtype == np.float64


def test_an_episode_of_support() -> None:
    """Both bars away at once: the ball falls freely from y = 340, and 0.1 s earlier or later shows in the reward."""
    actions = np.zeros((3, 6), np.float32)
    actions[0, :2] = [0.1 / 15, 0.2 / 15]
    actions[1, :2] = [1.0 / 15, 0.2 / 15]
    played = play_plans(["support"], [0, 0, 0], actions)
    np.testing.assert_array_equal(played.success, [True, True, False])
    np.testing.assert_array_equal(played.terminated, played.success)
    np.testing.assert_array_equal(played.truncated, [False, False, True])
    np.testing.assert_array_equal(played.eliminations, [2, 2, 0])
    np.testing.assert_array_equal(played.eliminate_at[:2, :2], [[1, 2], [10, 2]])
    np.testing.assert_array_equal(played.eliminate_at[2], [-1] * 6)
    assert played.steps[0] < played.steps[1] < played.steps[2] == 150
    expected = 1000.0 * played.success - 10 * played.eliminations - played.steps / 10
    np.testing.assert_allclose(played.reward, expected)
    assert not played.fault.any()


def test_slots_beyond_the_blocks_do_nothing() -> None:
    actions = np.full((2, 6), 0.5, np.float32)
    actions[:, :2] = [0.1 / 15, 0.2 / 15]
    actions[1, 2:] = 0
    played = play_plans(["support"], [0, 0], actions)
    np.testing.assert_array_equal(played.eliminate_at[0], played.eliminate_at[1])
    assert played.reward[0] == played.reward[1]


def test_a_mixture_comes_back_in_order() -> None:
    games = ("support", "spring")
    generator = np.random.default_rng(0)
    which = np.array([1, 0, 0, 1, 1, 0])
    actions = generator.uniform(0, 1, (6, 6)).astype(np.float32)
    actions[[2, 4]] = actions[[1, 0]]  # equal plans of both games
    mixed = play_plans(games, which, actions)
    for index in (0, 1):
        alone = play_plans(games[index : index + 1], np.zeros(3, int), actions[which == index])
        np.testing.assert_array_equal(mixed.success[which == index], alone.success)
        np.testing.assert_array_equal(mixed.steps[which == index], alone.steps)


ONE = np.zeros((1, 6), np.float32)
BAD: dict[str, tuple[tuple[Any, Any, Any], dict[str, Any], str]] = {
    "no scene": (([], [0], ONE), {}, "scenes: expected a sequence of at least one"),
    "one name": (("support", [0], ONE), {}, "scenes: expected a sequence of at least one"),
    "unknown game": ((["suport"], [0], ONE), {}, "suport"),
    "five slots": ((["support"], [0], ONE[:, :5]), {}, "actions: expected shape"),
    "one row": ((["support"], [0], ONE[0]), {}, "actions: expected shape"),
    "whole numbers": ((["support"], [0], ONE.astype(int)), {}, "actions: expected float32 or float64"),
    "text": ((["support"], [0], [["0"] * 6]), {}, "actions: expected float32 or float64"),
    "above one": ((["support"], [0], ONE + 1.5), {}, r"actions: expected values in \[0, 1\], got 1.5 in row 0"),
    "below zero": ((["support"], [0], ONE - 0.25), {}, r"actions: expected values in \[0, 1\]"),
    "not a number": ((["support"], [0], ONE * np.nan), {}, r"actions: expected values in \[0, 1\], got nan"),
    "infinite": ((["support"], [0], ONE + np.inf), {}, r"actions: expected values in \[0, 1\], got inf"),
    "too few scenes named": ((["support"], [0, 0], ONE), {}, "actions: expected 2 rows as in which, got 1"),
    "fractions of scenes": ((["support"], [0.0], ONE), {}, "which: expected integers, the scene of each plan"),
    "scene beyond the list": ((["support"], [1], ONE), {}, "which: expected indices into 1 scenes"),
    "scene before the list": ((["support"], [-1], ONE), {}, "which: expected indices into 1 scenes"),
    "rate not of tenths": ((["support"], [0], ONE), {"fps": 24}, "fps: expected a multiple of 10"),
    "rate zero": ((["support"], [0], ONE), {"fps": 0}, "fps: expected a positive whole number"),
    "reset zero": ((["support"], [0], ONE), {"resets": 0}, "resets"),
    "unknown type": ((["support"], [0], ONE), {"dtype": "float16"}, "dtype"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_get_one_line(case: str) -> None:
    arguments, options, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        play_plans(*arguments, **options)
    assert "\n" not in str(caught.value)


def test_scenes_may_be_names_and_scenes() -> None:
    scene = load_scene(SPLITS["basic"][0])
    assert load_scenes([scene, "hole"])[0] is scene
