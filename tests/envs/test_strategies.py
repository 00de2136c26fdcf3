"""The three strategies against plain loops around the reference, and their rules by hand."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import load_scene, make, plan_to_steps
from iphyre_jax.envs.protocols import PROTOCOLS
from iphyre_jax.envs.strategies import Combined, InAdvance, OnTheFly, removal_frames
from iphyre_jax.observations.official import object_rows, scene_features
from parity.engines.reference import ReferenceWorld
from parity.official.drivers import DRIVERS, combined, random_actions
from parity.official.environments import replay

OFFICIAL = PROTOCOLS["official"]
FREE = jnp.zeros(6, bool)
ALL = jnp.ones(6, bool)


class ReferenceSimulator:
    """The calls of the official class over the reference engine."""

    def __init__(self, game: str) -> None:
        self.scene = load_scene(game)
        self.features = scene_features(self.scene)
        self.resets = 0

    def reset(self) -> Any:
        self.resets += 1
        self.world = ReferenceWorld(self.scene, self.resets)
        return self._table()

    def get_action_space(self) -> list[list[float]]:
        self.reset()
        blocks = list(self.scene.eliminable_blocks)
        self.centres = {tuple(self.features.position[block].tolist()): block for block in blocks}
        return [[0.0, 0.0], *map(list, self.centres), *[[0.0, 0.0]] * (6 - len(blocks))]

    def step(self, pos: list[float]) -> tuple[Any, float, bool]:
        reward = -0.1
        block = self.centres.get(tuple(pos))
        if block is not None and self.world.alive[block]:
            self.world.eliminate(block)
            reward -= 10
        self.world.space.step(0.1)
        solved = self.world.solved()
        return self._table(), reward + 1000 * solved, solved

    def _table(self) -> Any:
        there = self.features.present.copy()
        there[: self.scene.n_objects] &= self.world.alive
        pose = np.zeros((12, 3))
        pose[: self.scene.n_objects] = np.nan_to_num(self.world.poses())
        return object_rows(self.features, pose[:, :2], pose[:, 2], there)


@cache
def environment(strategy: str, game: str, **options: Any) -> Any:
    return make(f"{strategy}/{game}-v1", dtype="float64", autoreset=False, **options)


@pytest.mark.slow
@pytest.mark.parametrize(("strategy", "game"), [("in-advance", "hole"), ("on-the-fly", "spring"), ("combined", "hole")])
def test_strategies_play_as_their_drivers_do(strategy: str, game: str) -> None:
    episodes, actions = [], []
    for seed in range(12):
        taken: list[Any] = []
        stream = random_actions(strategy, np.random.default_rng(seed))
        episodes.append(DRIVERS[strategy](ReferenceSimulator(game), _tap(stream, taken)))
        actions.append(np.array(taken, None if strategy != "on-the-fly" else np.int32))
    length = max(map(len, actions))
    padded = np.stack([np.concatenate([a, np.repeat(a[-1:], length - len(a), axis=0)]) for a in actions])
    with jax.enable_x64(True):
        env, params = environment(strategy, game, official_bugs=True)
        played = replay(env, params, np.zeros(len(episodes)), padded)
    for k, episode in enumerate(episodes):
        steps = len(episode.transitions)
        for name in ("terminated", "truncated"):
            official = [getattr(step, name) for step in episode.transitions]
            np.testing.assert_array_equal(played[name][k, :steps], official)
        official = [step.reward for step in episode.transitions]
        np.testing.assert_allclose(played["rewards"][k, :steps], official, rtol=1e-6, atol=1e-4)
        obs = [episode.start, *(step.observation for step in episode.transitions)]
        np.testing.assert_allclose(played["observations"][k, : steps + 1], obs, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(played["rewards"][k, steps:], 0)  # what has ended stays so


def _tap(stream: Iterator[Any], taken: list[Any]) -> Iterator[Any]:
    for action in stream:
        taken.append(action)
        yield action


def test_instants_round_as_numpy_does() -> None:
    rng = np.random.default_rng(0)
    near_half = (np.arange(300) + 0.5) / 300 + rng.uniform(-1e-7, 1e-7, 300)
    actions = np.concatenate([rng.uniform(0, 1, 20_000), near_half, np.arange(151) / 150]).astype(np.float32)
    expected = np.rint(np.round(actions * np.float32(15), 1) * 10)
    np.testing.assert_array_equal(jax.jit(removal_frames)(actions), expected)
    with jax.enable_x64(True):
        precise = actions.astype(np.float64)
        np.testing.assert_array_equal(jax.jit(removal_frames)(precise), np.rint(np.round(precise * 15, 1) * 10))


def test_what_is_no_share_is_no_instant() -> None:
    odd = np.array([np.nan, np.inf, -np.inf, -0.2, 1.2, 1e30], np.float32)
    np.testing.assert_array_equal(removal_frames(odd), -1)


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "int32"])
def test_a_whole_number_is_no_time_unless_it_is_a_share(dtype: str) -> None:
    """15 x 18 is 14 in a byte."""
    given = np.array([0, 1, 2, 9, 18, 28], dtype)
    action = InAdvance().action_space().array(given)
    np.testing.assert_array_equal(removal_frames(action), [0, 150, -1, -1, -1, -1])
    assert InAdvance().action_space().array(given.astype(np.float64)).dtype in (np.float32, np.float64)


def test_in_advance_ties_and_ends_by_hand() -> None:
    action = np.array([3.0, 3.0, 0.0, 15.0, 14.9, 0.04], np.float32) / np.float32(15)
    planned = InAdvance().plan_action(action, jnp.int32(0), FREE, ALL, OFFICIAL)
    np.testing.assert_array_equal(planned.plan, [30, -1, -1, -1, 149, -1])
    assert planned.stop_step == 150
    smooth = InAdvance().plan_action(action, jnp.int32(0), FREE, ALL, PROTOCOLS["smooth"])
    np.testing.assert_array_equal(smooth.plan, [180, -1, -1, -1, 894, -1])


def test_in_advance_is_the_rule_for_plans_in_seconds() -> None:
    actions = np.random.default_rng(0).uniform(-0.01, 1.01, (500, 6)).clip(0, 1).astype(np.float32)
    actions[:, 3] = actions[:, 1]
    ours = jax.vmap(lambda action: InAdvance().plan_action(action, jnp.int32(0), FREE, ALL, OFFICIAL).plan)(actions)
    np.testing.assert_array_equal(ours, plan_to_steps(actions * np.float32(15), OFFICIAL.fps, "in_advance"))


def test_on_the_fly_by_hand() -> None:
    for action, plan in ((0, [-1] * 6), (2, [-1, 7, -1, -1, -1, -1]), (7, [-1] * 6), (-1, [-1] * 6)):
        planned = OnTheFly().plan_action(jnp.int32(action), jnp.int32(7), FREE, ALL, OFFICIAL)
        np.testing.assert_array_equal(planned.plan, plan)
        assert planned.stop_step == 8


def test_combined_by_hand() -> None:
    times = np.array([3.0, 5.0, 3.0, 9.0, 0.0, 0.0], np.float32) / np.float32(15)

    def planned(step: int, executed: Any, present: Any) -> Any:
        return Combined().plan_action(times, jnp.int32(step), jnp.asarray(executed), jnp.asarray(present), OFFICIAL)

    first = planned(0, [False] * 6, [True] * 6)
    np.testing.assert_array_equal(first.plan, [30, -1, -1, -1, -1, -1])  # slot 2 lost the tie
    assert first.stop_step == 31
    np.testing.assert_array_equal(first.executed, [True] + [False] * 5)
    # Slot 0 is executed and takes the tie with it; the next is slot 1.
    second = planned(20, first.executed, [False] + [True] * 5)
    np.testing.assert_array_equal(second.plan, [-1, 50, -1, -1, -1, -1])
    # A slot without a block is passed over, and with nothing due the rest is played.
    third = planned(51, [True, True] + [False] * 4, [False, False, True, False, False, False])
    np.testing.assert_array_equal(third.plan, [-1] * 6)
    assert third.stop_step == 150


def test_the_late_frame_is_an_option() -> None:
    late: list[int] = []
    for start in range(150):
        action = np.zeros(6, np.float32)
        fixed = Combined().plan_action(action, jnp.int32(start), FREE, ALL, OFFICIAL)
        official = Combined(late_frame=True).plan_action(action, jnp.int32(start), FREE, ALL, OFFICIAL)
        assert fixed.stop_step == 150
        assert official.stop_step in (150, 151)
        late += [start] if official.stop_step == 151 else []
    assert len(late) == 19
    assert late[:4] == [87, 92, 97, 102]
    assert late[-1] == 147
    last = np.full(6, 1.0, np.float32)  # 15.0 s, an instant of the late frame alone
    planned = Combined(late_frame=True).plan_action(last, jnp.int32(87), FREE, ALL, OFFICIAL)
    np.testing.assert_array_equal(planned.plan, [150, -1, -1, -1, -1, -1])
    assert planned.stop_step == 151


def test_the_late_frame_costs_a_tenth() -> None:
    early = np.full((1, 2, 6), 0, np.float32)
    early[0, 0, 0] = 8.6 / 15  # the next action starts at frame 87
    driven = combined(ReferenceSimulator("hole"), iter(early[0]))
    with jax.enable_x64(True):
        env, params = environment("combined", "hole", official_bugs=True)
        total = replay(env, params, np.zeros(1), early)["rewards"].sum()
    np.testing.assert_allclose(total, sum(step.reward for step in driven.transitions), atol=1e-4)
    np.testing.assert_allclose(total, -25.1, atol=1e-4)
    env, params = make("combined/hole-v1", official_bugs=True, autoreset=False)
    key, step = jax.random.key(0), jax.jit(env.step)
    _, state = env.reset(key, params)
    for action in early[0]:
        *_, info = step(key, state, action, params)
        _, state, *_ = step(key, state, action, params)
    assert float(info["time"]) == pytest.approx(15.1)
