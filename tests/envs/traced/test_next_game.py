"""Which game follows: drawn where an episode has ended, with the bits of `jax.random.randint`."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.batching.next_game import NO_GAME, NextGame

GAMES, WORLDS = 7, 64


def draw(keys: jax.Array) -> jax.Array:
    return jax.vmap(lambda key: jax.random.randint(key, (), 0, GAMES, jnp.int32))(keys)


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize("typed", [True, False])
def test_a_random_game_is_that_of_its_key(typed: bool, kept: bool) -> None:
    keys = jax.random.split(jax.random.key(3) if typed else jax.random.PRNGKey(3), WORLDS)
    with jax.threefry_partitionable(kept):
        next_game = jax.vmap(lambda key: NextGame.random(key, GAMES))(keys)
        assert (next_game.key is not None) == kept  # other bits are drawn at once
        expected = np.asarray(draw(keys))
    assert len(np.unique(expected)) == GAMES
    np.testing.assert_array_equal(next_game.drawn().game, expected)


def test_keys_of_another_generator_draw_at_once() -> None:
    keys = jax.random.split(jax.random.key(3, impl="rbg"), WORLDS)
    next_game = jax.vmap(lambda key: NextGame.random(key, GAMES))(keys)
    assert next_game.key is None
    np.testing.assert_array_equal(next_game.drawn().game, draw(keys))


def test_given_games_are_not_drawn() -> None:
    game = jnp.array([NO_GAME, 0, 5], jnp.int32)
    for given in (NextGame(game), NextGame(game).with_keys()):
        np.testing.assert_array_equal(given.drawn().game, game)
    assert int(NextGame.random(jax.random.key(0), 1).row()) == 0


def test_an_environment_draws_them() -> None:
    iphyre_jax.register("drawn-v1", ["hole", "hole", "hole"], overwrite=True)
    for impl in ("threefry2x32", "rbg"):
        keys = jax.random.split(jax.random.key(5, impl=impl), WORLDS)
        env, params = iphyre_jax.make("on-the-fly/drawn-v1", backend="xla")
        state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)[1]
        never, ended = jnp.zeros(WORLDS, jnp.int32), jnp.zeros(WORLDS, bool)
        step = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))
        for _ in range(env.protocol.steps):
            _, state, _, terminated, truncated, _ = step(keys, state, never, params)
            ended = terminated | truncated
        assert ended.all()
        expected = jax.vmap(lambda key: jax.random.randint(key, (), 0, 3, jnp.int32))(keys)
        np.testing.assert_array_equal(state.game, expected)
