"""Episodes in few words, and worlds with more contacts than nearly all have."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.batching.play_requests import PlayRequest, run_requests, run_with_few_slots
from iphyre_jax.envs.batching.status import status_of, status_words
from iphyre_jax.envs.core import BackendName
from iphyre_jax.envs.traced.episode_rows import CROWDED, EpisodeRows
from iphyre_jax.envs.traced.worlds import TracedState
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState, reset_episode
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import compile_scene, step_timing
from tests.trees import assert_equal_trees

BLOCKS = 6
WALLS = [[[270.5, 300], [270.5, 390]], [[329.5, 300], [329.5, 390]]]
FLOOR = [[[250, 410], [350, 410]]]


def scene(name: str, x: float) -> Scene:
    """A ball on a floor; between the walls, at x = 300, it touches both, too."""
    return Scene(name, WALLS + FLOOR, [[x, 380, 20]], [False, False, True, False], [False] * 3 + [True])


CUP, OPEN = scene("cup", 300), scene("open", 410)


def in_lanes(dtype: str, scenes: list[Scene]) -> tuple[Topology, Timing, World]:
    compiled = [compile_scene(each, dtype=dtype) for each in scenes]
    (topology,) = {topology for topology, _ in compiled}
    worlds = jax.tree.map(lambda *leaves: np.stack(leaves, axis=-1), *[world for _, world in compiled])
    return topology, jax.tree.map(jnp.asarray, step_timing(60, dtype)), worlds


@partial(jax.jit, static_argnums=(0, 1))
def played(few: bool, topology: Topology, timing: Timing, world: World, stop: Any) -> EpisodeState:
    """Play episodes whose floor is removed before step 4, from the start and then on."""
    run = run_with_few_slots if few else run_requests
    episode = reset_episode(topology, world, jnp.zeros(stop.shape[1:], bool))
    plan = jnp.full((BLOCKS, *stop.shape[1:]), -1, jnp.int32).at[0].set(4)
    for until in stop:
        episode = run(topology, timing, world, PlayRequest(plan, until), episode)
    return episode


@pytest.fixture(scope="module")
def episodes() -> tuple[Topology, World, EpisodeState, EpisodeState]:
    """Of cups and open worlds, after several decisions; with few slots first, and with all."""
    with jax.enable_x64(True):
        topology, timing, world = in_lanes("float64", [CUP, OPEN, CUP, OPEN])
        stop = jnp.asarray([[3, 3, 2, 3], [9, 9, 2, 3], [12, 10, 3, 9]], jnp.int32)
        few, every = (played(few, topology, timing, world, stop) for few in (True, False))
        return topology, world, few, every


def test_worlds_that_need_more_slots_are_played_with_all(episodes: Any) -> None:
    topology, _, few, every = episodes
    assert topology.few_slots == 2
    in_use = (np.asarray(every.state.cache.point) >= 0).sum(axis=1)
    assert (in_use > 2).any(axis=0).tolist() == [False, False, True, False]
    assert not every.state.overflow.any()
    assert_equal_trees(few, every)


def test_rows_keep_all_of_an_episode(episodes: Any) -> None:
    topology, world, episode, _ = episodes
    executed = jnp.asarray(np.random.default_rng(0).random((BLOCKS, 4)) < 0.5)
    with jax.enable_x64(True):
        status = status_of(jnp.asarray([3, 1, 2, 900], jnp.int32), world, episode, executed)
        rows = EpisodeRows(topology, BLOCKS, "float64")
        parts = rows.pack(status, episode)
        assert (len(parts.whole), len(parts.numbers)) == rows.all
        assert_equal_trees(rows.join(parts.padded((100, 100))), (status, episode))
        crowded = rows.is_crowded(parts.whole)
    np.testing.assert_array_equal(crowded, (np.asarray(episode.state.cache.point)[:, 2:] >= 0).any(axis=(0, 1)))
    assert 0 < crowded.sum() < 4


def told(backend: BackendName, dtype: str, games: Any, decisions: int = 12) -> tuple[Any, Any]:
    """Play both scenes on the fly; return what is told, and the last states."""
    iphyre_jax.register("crowded-v1", [CUP, OPEN], overwrite=True)
    with jax.enable_x64(dtype == "float64"):
        env, params = iphyre_jax.make("on-the-fly/crowded-v1", protocol="smooth", dtype=dtype, backend=backend)
        game = jnp.asarray(games, jnp.int32)
        keys = jax.random.split(jax.random.key(0), (decisions, len(game)))
        actions = jnp.zeros((decisions, len(game)), jnp.int32).at[decisions // 2, ::2].set(1)

        @jax.jit
        def play(state: Any) -> Any:
            def turn(state: Any, given: Any) -> Any:
                obs, state, *rest = jax.vmap(env.step, in_axes=(0, 0, 0, None))(given[0], state, given[1], params)
                return state, (obs, rest, state)

            return jax.lax.scan(turn, state, (keys, actions))[1]

        obs, rest, states = play(jax.vmap(env.reset_to, in_axes=(0, None))(game, params)[1])
        return jax.tree.map(np.asarray, ((obs, rest), states))


@pytest.mark.slow
def test_crowded_worlds_are_the_same_on_both_backends() -> None:
    games = np.arange(20) % 2
    (host, _), (xla, states) = (told(backend, "float64", games) for backend in ("host", "xla"))
    assert_equal_trees(host, xla)
    assert isinstance(states, TracedState)
    crowded = (np.asarray(states.parts.whole)[:, :, status_words(BLOCKS)] >> CROWDED) & 1
    assert 0 < crowded.sum() < crowded.size


@pytest.mark.slow
def test_crowded_neighbours_change_no_bit() -> None:
    games = np.arange(20) % 4 // 2
    one, other = (told("xla", "float32", own) for own in (games, np.where(np.arange(20) < 8, games, 0)))
    of = jax.tree.map(lambda leaf: leaf[:, :8], (one, other))
    assert_equal_trees(*of)
