"""The pool with EnvPool's calls."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future

import jax
import numpy as np
import pytest

from iphyre_jax.adapters import HostPool
from iphyre_jax.envs.arguments import key_of

WORLDS = 4
DECISIONS = 3


@pytest.fixture(scope="module")
def pool() -> Iterator[HostPool]:
    one = HostPool("on-the-fly/support-v1", WORLDS, batch_size=2)
    yield one
    one.close()


def _actions(worlds: np.ndarray, decision: int) -> np.ndarray:
    return (worlds + decision) % 3


def test_all_of_a_seed_counts() -> None:
    """Its upper 32 bits too."""
    seen = [HostPool("on-the-fly/basic-v1", 16, seed=seed).reset()[0].tolist() for seed in (1, 1 + 2**32, 1)]
    assert seen[0] == seen[2] != seen[1]


def test_batches_of_half_the_worlds_play_what_one_batch_plays(pool: HostPool) -> None:
    whole = HostPool("on-the-fly/support-v1", WORLDS)
    obs, info = whole.reset()
    expected = [obs]
    np.testing.assert_array_equal(info["env_id"], np.arange(WORLDS))
    assert set(info) == {"eliminations", "env_id", "fault", "final_observation", "game", "success", "time"}
    np.testing.assert_array_equal(info["time"], 0)
    rewards = []
    for decision in range(DECISIONS):
        obs, reward, terminated, truncated, info = whole.step(_actions(np.arange(WORLDS), decision))
        assert (obs.dtype, reward.dtype, terminated.dtype, truncated.dtype) == (np.float32, np.float32, bool, bool)
        assert obs.shape == info["final_observation"].shape == (WORLDS, *whole.observation_space.shape)
        expected.append(obs)
        rewards.append(reward)
    whole.close()
    assert len(np.unique(rewards)) > 1
    pool.async_reset()
    seen = np.zeros(WORLDS, int)
    for _ in range(2 * (DECISIONS + 1)):
        obs, reward, _, _, info = pool.recv()
        worlds = info["env_id"]
        decision = int(seen[worlds[0]])
        np.testing.assert_array_equal(obs, expected[decision][worlds])
        if decision:
            np.testing.assert_array_equal(reward, rewards[decision - 1][worlds])
        seen[worlds] += 1
        if decision < DECISIONS:
            pool.send(_actions(worlds, decision), worlds)
    np.testing.assert_array_equal(seen, DECISIONS + 1)
    with pytest.raises(ValueError, match=r"^recv: expected a call of send, reset or async_reset before$"):
        pool.recv()


def test_a_play_that_fails_loses_its_batch_alone(pool: HostPool, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise MemoryError("no room")

    pool.async_reset()
    batches = [pool.recv()[-1]["env_id"] for _ in range(2)]
    with monkeypatch.context() as failing:
        failing.setattr(pool, "_step", fail)
        pool.send(_actions(batches[0], 0), batches[0])
        with pytest.raises(MemoryError, match="no room"):
            pool.recv()
    pool.send(_actions(batches[0], 0), batches[0])  # the worlds are as they were
    np.testing.assert_array_equal(pool.recv()[-1]["env_id"], batches[0])
    with monkeypatch.context() as failing:
        failing.setattr(pool, "_reset", fail)
        pool.async_reset()
        with pytest.raises(MemoryError):
            pool.recv()
    pool.async_reset()  # what failed before is forgotten
    assert [len(pool.recv()[1]) for _ in range(2)] == [2, 2]


def test_an_interrupt_while_a_batch_plays_does_not_lose_it(pool: HostPool, monkeypatch: pytest.MonkeyPatch) -> None:
    pool.async_reset()
    batches = [pool.recv()[-1]["env_id"] for _ in range(2)]
    pool.send(_actions(batches[1], 0), batches[1])
    with monkeypatch.context() as interrupted:
        interrupted.setattr(Future, "result", _interrupt)
        with pytest.raises(KeyboardInterrupt):
            pool.recv()
    np.testing.assert_array_equal(pool.recv()[-1]["env_id"], batches[1])


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("env_id", "message"),
    [
        ([0, 1], "world 1 has no such values"),
        ([0, 0], "each once"),
        ([0, 9], "from 0 to 3"),
        ([0.0, 2.0], "2 whole numbers"),
        (None, "2 whole numbers"),
    ],
)
def test_actions_for_worlds_that_wait_for_none_are_refused(pool: HostPool, env_id: object, message: str) -> None:
    pool.async_reset()
    worlds = pool.recv()[-1]["env_id"]
    pool.send([0, 0], worlds)
    pool.recv()  # of the other two
    pool._waiting[:] = [True, False, True, False]  # whichever were first
    with pytest.raises(ValueError, match=r"^env_id: expected") as caught:
        pool.send([0, 0], env_id)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"^action: expected numbers from 0 to 6"):
        pool.send([0, 7], [0, 2])
    with pytest.raises(ValueError, match=r"^reset: expected async_reset"):
        pool.reset()


def test_an_episode_in_advance_ends_by_itself_and_another_begins() -> None:
    pool = HostPool("in-advance/support-v1", 2)
    first, _ = pool.reset()
    obs, _, terminated, truncated, info = pool.step(np.zeros((2, 6), np.float32))
    pool.close()
    assert terminated.all()
    assert not truncated.any()
    assert not info["success"].any()
    np.testing.assert_array_equal(obs, first)
    assert (info["final_observation"] != first).any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 4, "batch_size": 3}, "batch_size: expected a divisor of 4, got 3"),
        ({"num_envs": 0}, "num_envs: expected"),
        ({"autoreset": False}, "autoreset: expected none"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        HostPool("on-the-fly/support-v1", **arguments)


def test_a_closed_pool_says_so() -> None:
    pool = HostPool("on-the-fly/hole-v1", 2, backend="host")
    pool.async_reset()
    pool.close()
    for call in (pool.recv, pool.async_reset, pool.reset, lambda: pool.send(np.zeros(2, np.int32))):
        with pytest.raises(ValueError, match=r"^\w+: expected a pool that is open, got one after close$"):
            call()
    pool.close()


def test_seeds_of_more_than_32_bits_differ() -> None:
    keys = [jax.random.key_data(key_of(seed)).tolist() for seed in (0, 2**32, 2**33, 1, 2**32 + 1)]
    assert len(set(map(tuple, keys))) == 5
    assert keys[3] == jax.random.key_data(jax.random.key(1)).tolist()
