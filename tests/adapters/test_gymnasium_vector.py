"""The vector environment in each mode of autoreset, against gymnasium's own over single environments; its options."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import iphyre_jax
from iphyre_jax.adapters import GymnasiumEnv, GymnasiumVectorEnv

ID = "in-advance/vectors-v1"  # one decision is an episode, so that every mode shows soon


@pytest.fixture(autouse=True)
def _games() -> None:
    iphyre_jax.register("vectors-v1", ["support", "hole"], overwrite=True)


def _same(ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
    for here, there in zip(ours[:-1], theirs[:-1], strict=True):
        np.testing.assert_allclose(here, there, atol=1e-6)
    assert set(theirs[-1]) <= set(ours[-1])
    for name in ("game", "success", "eliminations", "official_truncated", "_game"):
        np.testing.assert_array_equal(ours[-1][name], theirs[-1][name], err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_autoreset_is_that_of_gymnasium(mode: AutoresetMode) -> None:
    ours = GymnasiumVectorEnv(ID, 3, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: GymnasiumEnv(ID)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
    _same(ours.reset(seed=3), theirs.reset(seed=3))
    rng, games = np.random.default_rng(0), set()
    for _ in range(7):
        actions = rng.uniform(0, 1, (3, 6)).astype(np.float32)
        step = ours.step(actions)
        _same(step, theirs.step(actions))
        games |= set(step[-1]["game"].tolist())
    _same(ours.reset(), theirs.reset())  # the generators go on
    assert games == {0, 1}


def test_time_is_exact() -> None:
    envs = GymnasiumVectorEnv("on-the-fly/support-v1", 2)
    envs.reset(seed=0)
    for _ in range(3):
        infos = envs.step(np.zeros(2, np.int32))[-1]
    assert infos["time"].tolist() == [0.3, 0.3]


def test_generators_are_those_of_gymnasium() -> None:
    ours, theirs = GymnasiumVectorEnv(ID, 3), SyncVectorEnv([lambda: GymnasiumEnv(ID)] * 3)
    for seed in (5, [7, None, 9], None):
        ours.reset(seed=seed)
        theirs.reset(seed=seed)
        if seed == 5:
            assert ours.np_random_seed == theirs.np_random_seed == (5, 6, 7)
        assert ours.np_random_seed[::2] == theirs.np_random_seed[::2]
    assert tuple(one.bit_generator.seed_seq.entropy for one in ours.np_random) == ours.np_random_seed


@pytest.mark.parametrize("fill", [-1.0, np.nan])
def test_the_action_of_an_ended_world_may_be_any(fill: float) -> None:
    """In next step: trainers fill it in. That of another world may not."""
    envs = GymnasiumVectorEnv(ID, 2, autoreset_mode="NextStep")
    envs.reset(seed=0)
    filler = np.full((2, 6), fill, np.float32)
    with pytest.raises(ValueError, match=r"^action: expected numbers from 0 to 1"):
        envs.step(filler)
    assert envs.step(np.zeros((2, 6), np.float32))[2].all()
    obs, rewards, terminated, _, _ = envs.step(filler)
    np.testing.assert_array_equal(filler, fill)
    assert not rewards.any()
    assert not terminated.any()
    assert envs.observation_space.contains(obs)


@pytest.mark.slow
def test_without_autoreset_the_user_begins_episodes() -> None:
    ours = GymnasiumVectorEnv("on-the-fly/support-v1", 3, autoreset_mode="Disabled")
    theirs = SyncVectorEnv([lambda: GymnasiumEnv("on-the-fly/support-v1")] * 3, autoreset_mode=AutoresetMode.DISABLED)
    with pytest.raises(ValueError, match="options: expected all worlds in the reset_mask of the first reset"):
        ours.reset(options={"reset_mask": np.array([True, False, False])})
    _same(ours.reset(seed=3), theirs.reset(seed=3))
    resets = 0
    for k in range(40):
        actions = np.array([(1 + k) % 3, 0, 2 - k % 3])
        step = ours.step(actions)
        _same(step, theirs.step(actions))
        ended = step[2] | step[3]
        if ended.any():
            resets += 1
            with pytest.raises(ValueError, match=r"^step: expected a reset .* got \d ended$"):
                ours.step(actions)
            _same(ours.reset(options={"reset_mask": ended}), theirs.reset(options={"reset_mask": ended}))
    assert resets


def test_options_choose_games() -> None:
    envs = GymnasiumVectorEnv(ID, 4)
    assert envs.reset(seed=0, options={"game": "hole"})[1]["game"].tolist() == [1] * 4
    assert envs.reset(seed=0, options={"game": ["hole", 0, "support", 1]})[1]["game"].tolist() == [1, 0, 0, 1]
    single = GymnasiumEnv(ID)
    np.testing.assert_array_equal(envs.reset(options={"game": 1})[0][2], single.reset(options={"game": 1})[0])


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "name": ({"game": "spring"}, "options: expected a game of"),
    "number": ({"game": 2}, "options: expected a game of"),
    "three": ({"game": [0, 1, 0]}, "options: expected one game, or 2, got 3"),
    "mask of three": ({"reset_mask": np.ones(3, bool)}, "options: expected a reset_mask of 2 bool"),
    "mask of numbers": ({"reset_mask": np.ones(2)}, "options: expected a reset_mask of 2 bool"),
    "empty mask": ({"reset_mask": np.zeros(2, bool)}, "options: expected a reset_mask of 2 bool"),
    "unknown": ({"level": 1}, "options: expected none but game and reset_mask, got level"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_options_get_one_line(case: str) -> None:
    options, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        GymnasiumVectorEnv(ID, 2).reset(options=options)
    assert "\n" not in str(caught.value)


def test_an_unknown_mode_gets_one_line() -> None:
    with pytest.raises(ValueError, match="autoreset_mode: expected one of NextStep, SameStep, Disabled, got 'later'"):
        GymnasiumVectorEnv(ID, 2, autoreset_mode="later")


@pytest.mark.slow
def test_pictures_are_those_of_single_environments() -> None:
    envs = GymnasiumVectorEnv(ID, 2, render_mode="rgb_array")
    assert envs.render() is None
    envs.reset(options={"game": [0, 1]})
    pictures = envs.render()
    assert pictures is not None
    assert GymnasiumVectorEnv(ID, 2).render() is None
    for game, one in enumerate(pictures):
        single = GymnasiumEnv(ID, render_mode="rgb_array")
        single.reset(options={"game": game})
        np.testing.assert_array_equal(one, single.render())


@pytest.mark.slow
def test_wrappers_of_gymnasium_that_know_one_mode_only() -> None:
    envs = GymnasiumVectorEnv(ID, 4, autoreset_mode="NextStep")
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        gymnasium.wrappers.vector.NormalizeReward(gymnasium.wrappers.vector.NormalizeObservation(envs))
    )
    wrapped.reset(seed=0)
    lengths = []
    for _ in range(6):
        _, _, terminated, _, infos = wrapped.step(wrapped.action_space.sample())
        lengths += infos["episode"]["l"][terminated].tolist() if terminated.any() else []
    assert lengths == [1] * 12  # every other call begins an episode


@pytest.mark.slow
@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.parametrize("duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy])  # noqa: S301
def test_copies_go_on_as_the_original(vector: bool, duplicate: Any) -> None:
    """In the middle of an episode; float64, whose words JAX would cut in half where x64 is off."""
    options = {"dtype": "float64", "observation": "motion"}
    name = "on-the-fly/support-v1"
    env = GymnasiumVectorEnv(name, 2, **options) if vector else GymnasiumEnv(name, **options)
    env.reset(seed=0)
    actions = np.array([1, 0]) if vector else 1
    for _ in range(3):
        env.step(actions)
    twin = duplicate(env)
    for k in range(35):
        action = actions * 0 + 2 * (k == 2)
        for here, there in zip(env.step(action)[:4], twin.step(action)[:4], strict=True):
            np.testing.assert_array_equal(here, there)
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])
