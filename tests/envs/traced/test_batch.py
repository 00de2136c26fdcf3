"""One decision of a batch: next episodes, of which rows and nothing else are replaced; the same on any device."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.batching.next_game import NO_GAME, NextGame
from iphyre_jax.envs.batching.play_requests import pack_request
from iphyre_jax.envs.batching.status import GAME, SUCCESS
from iphyre_jax.envs.traced import batch, cpu_batch, cpu_groups
from iphyre_jax.envs.traced.cpu_groups import Given
from iphyre_jax.envs.traced.step import Episode, Games, StepInput
from iphyre_jax.envs.traced.step_program import linked_steps
from iphyre_jax.envs.traced.worlds import TracedParams, TracedState, TracedWorlds
from iphyre_jax.execution.layout import Parts
from iphyre_jax.execution.machine_code.linking import can_link
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.scenes.compile import step_timing
from tests.trees import assert_equal_trees

ROWS, GAMES = 9, 6
WORLDS = np.array([3, 7, 1, 8], np.int32)
FOLLOWS = np.array([True, False, False, True])
# The last world draws one of three games.
NEXT, FIRST_GAME = np.array([2, -1, 1, NO_GAME - 3], np.int32), np.array([0, 0, 0, 3], np.int32)
KEYS = jax.random.split(jax.random.key(7), ROWS)


def episodes(size: int, seed: int) -> Episode:
    rng = np.random.default_rng(seed)
    whole = jnp.asarray(rng.integers(0, 100, (size, 5)), jnp.int32)
    numbers, obs = (jnp.asarray(rng.random((size, width)), jnp.float32) for width in (7, 3))
    return Episode(Parts(whole, numbers), obs)


def begun(now: Episode, starts: Episode, follows: Any = FOLLOWS) -> Episode:
    every = np.arange(ROWS, dtype=np.int32)
    game, first_game = every.copy(), every.copy()
    game[WORLDS], first_game[WORLDS] = NEXT, FIRST_GAME
    games = Games(jnp.zeros(GAMES, jnp.int32), starts.state, starts)
    timing = jax.tree.map(jnp.asarray, step_timing(10, "float32"))
    rows = jnp.asarray(every)
    next_game = NextGame(jnp.asarray(game), jax.random.key_data(KEYS))
    batch = Given(timing, games, jnp.int32(GAMES), rows, rows[:, None], next_game, jnp.asarray(first_game))
    return cpu_groups.begin(now, batch, jnp.asarray(follows), jnp.asarray(WORLDS))


def expected(now: Any, starts: Any, game: bool) -> Any:
    out = np.array(now)
    for lane in np.flatnonzero(FOLLOWS):
        row = NEXT[lane] if lane < 3 else jax.random.randint(KEYS[WORLDS[lane]], (), 0, 3)
        out[WORLDS[lane]] = np.array(starts)[FIRST_GAME[lane] + row]
        if game:
            out[WORLDS[lane], GAME] = row
    return out


def test_rows_of_the_next_games_are_copied() -> None:
    now, starts = episodes(ROWS, 0), episodes(GAMES, 1)
    out = jax.jit(begun)(now, starts)
    np.testing.assert_array_equal(out.state.whole, expected(now.state.whole, starts.state.whole, True))
    np.testing.assert_array_equal(out.state.numbers, expected(now.state.numbers, starts.state.numbers, False))
    np.testing.assert_array_equal(out.obs, expected(now.obs, starts.obs, False))


def test_tangents_of_the_rows_are_copied() -> None:
    now, starts = episodes(ROWS, 0), episodes(GAMES, 1)
    way, of_starts = episodes(ROWS, 2).state.numbers, episodes(GAMES, 3).state.numbers

    def numbers(mine: jax.Array, theirs: jax.Array) -> jax.Array:
        changed = [one._replace(state=one.state._replace(numbers=of)) for one, of in ((now, mine), (starts, theirs))]
        return begun(*changed).state.numbers

    _, tangent = jax.jvp(numbers, (now.state.numbers, starts.state.numbers), (way, of_starts))
    np.testing.assert_array_equal(tangent, expected(way, of_starts, False))


def test_without_an_end_all_stays() -> None:
    now = episodes(ROWS, 0)
    jax.tree.map(np.testing.assert_array_equal, begun(now, episodes(GAMES, 1), np.zeros(len(WORLDS), bool)), now)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "worlds"),
    [
        (["hole", "multi_ball_hole", "support"], 300),
        pytest.param(["hole"], 256, marks=pytest.mark.further),
        pytest.param(["hole"], 130, marks=pytest.mark.further),
    ],
)
def test_accelerators_and_linked_programs_play_the_same_in_groups(names: list[str], worlds: int) -> None:
    """Episodes in several groups of lanes, a part of which end and begin anew, to the last bit."""
    iphyre_jax.register("groups-v1", names, overwrite=True)
    with jax.enable_x64(True):
        env, params = iphyre_jax.make("on-the-fly/groups-v1", backend="xla", dtype="float64", final_observation=True)
        assert isinstance(env.worlds, TracedWorlds)
        assert isinstance(params, TracedParams)
        assert len(env.topologies) == min(len(names), 2)
        step, rng = env.worlds.traced, np.random.default_rng(0)
        game = jnp.asarray(rng.integers(0, len(names), worlds), jnp.int32)
        state = jax.vmap(env.reset_to, in_axes=(0, None))(game, params)[1]
        assert isinstance(state, TracedState)
        plan = jnp.asarray(rng.integers(0, 9, (worlds, step.limits.blocks)), jnp.int32)
        request = jax.vmap(pack_request)(plan, jnp.full(worlds, 60, jnp.int32), jnp.zeros(plan.shape, bool))
        following = jnp.asarray(rng.integers(NO_GAME - len(names), len(names), worlds), jnp.int32)
        next_game = NextGame(following, jax.random.key_data(jax.random.split(jax.random.key(0), worlds)))
        given = StepInput(state.parts, request, next_game, jnp.zeros(worlds, jnp.int32))
        shared = jax.tree.map(jnp.asarray, step_timing(env.protocol.fps, "float64")), params.table
        on_cpu = jax.jit(partial(cpu_batch.play_on_cpu, step, in_one_function))(shared, given)
        elsewhere = jax.jit(partial(batch._play_groups, step))(shared, given)
        on_cpu, elsewhere = jax.tree.map(np.asarray, (on_cpu, elsewhere))
        programs = linked_steps(step, worlds, len(params.topology_id))
        assert bool(programs) == can_link()
        if programs:
            linked = jax.jit(partial(cpu_batch.play_linked, programs, step))(shared, given)
            assert_equal_trees(on_cpu, jax.tree.map(np.asarray, linked))
    assert 0 < (on_cpu.status[:, SUCCESS] != 0).sum() < worlds
    assert_equal_trees(on_cpu, elsewhere)


@pytest.mark.parametrize("names", [pytest.param(["hole"], marks=pytest.mark.further), ["hole", "support"]])
@pytest.mark.parametrize("worlds", [*(pytest.param(few, marks=pytest.mark.further) for few in (1, 3)), 128])
def test_a_batch_may_be_known_to_the_compiler(names: list[str], worlds: int) -> None:
    """XLA then takes loops apart, and jaxlib 0.10.2 ended the process."""
    iphyre_jax.register("known-v1", names, overwrite=True)
    env, params = iphyre_jax.make("on-the-fly/known-v1", backend="xla", protocol="smooth")
    keys, action = jax.random.split(jax.random.key(0), worlds), jnp.ones(worlds, jnp.int32)
    game = jnp.arange(worlds, dtype=jnp.int32) % len(names)
    _, state = jax.vmap(env.reset_to, in_axes=(0, None))(game, params)
    step = jax.vmap(env.step, in_axes=(0, 0, 0, None))
    known, given = jax.jit(lambda: step(keys, state, action, params))(), jax.jit(step)(keys, state, action, params)
    assert_equal_trees((known[0], known[2:]), (given[0], given[2:]))


def test_a_program_is_lowered_as_it_was_traced() -> None:
    """Under x64, although it is lowered outside."""
    with jax.enable_x64(True):
        env, params = iphyre_jax.make("on-the-fly/hole-v1", dtype="float64", backend="xla")
        keys, actions = jax.random.split(jax.random.key(0), 2), jnp.zeros(2, jnp.int32)
        _, state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
        traced = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None))).trace(keys, state, actions, params)
    assert "tensor<2x122xf32>" in traced.lower().as_text()
