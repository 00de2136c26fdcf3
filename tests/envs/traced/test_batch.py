"""Next episodes of a group of lanes: their rows, and nothing else, are replaced; derivatives too."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.batching.status import GAME
from iphyre_jax.envs.traced import batch
from iphyre_jax.envs.traced.step import Episode, StepInput
from iphyre_jax.execution.layout import Parts

ROWS, GAMES, LANES, FIRST = 9, 6, 4, 3
FOLLOWS = np.array([True, False, False, True])
NEXT, FIRST_GAME = np.array([2, -1, 1, 0], np.int32), np.array([0, 0, 0, 3], np.int32)


def episodes(size: int, seed: int) -> Episode:
    rng = np.random.default_rng(seed)
    whole = jnp.asarray(rng.integers(0, 100, (size, 5)), jnp.int32)
    numbers, obs = (jnp.asarray(rng.random((size, width)), jnp.float32) for width in (7, 3))
    return Episode(Parts(whole, numbers), obs)


def begun(now: Episode, starts: Episode, follows: Any = FOLLOWS) -> Episode:
    request = jnp.zeros((LANES, 3), jnp.int32)
    given = StepInput(Parts(now.state.whole[:LANES], now.state.numbers[:LANES]), request, NEXT, FIRST_GAME)
    given = jax.tree.map(jnp.asarray, given)
    return batch._begin(now, starts, given, jnp.asarray(follows), jnp.int32(FIRST))


def expected(now: Any, starts: Any, game: bool) -> Any:
    out = np.array(now)
    for lane in np.flatnonzero(FOLLOWS):
        out[FIRST + lane] = np.array(starts)[FIRST_GAME[lane] + NEXT[lane]]
        if game:
            out[FIRST + lane, GAME] = NEXT[lane]
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
    jax.tree.map(np.testing.assert_array_equal, begun(now, episodes(GAMES, 1), np.zeros(LANES, bool)), now)
