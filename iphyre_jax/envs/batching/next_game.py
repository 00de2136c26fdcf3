"""The game that follows when an episode ends; a random one is drawn where an episode has ended, and nowhere else."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

NO_GAME = -1
GENERATOR = "threefry2x32"  # JAX's own, whose keys are two words


class NextGame(NamedTuple):
    """Which game follows. Shapes are those of one world; many worlds are one a row."""

    game: jax.Array  # () int32, row of the parameters; -1 for none; -1 - n for a random one of the first n rows
    key: jax.Array | None = None  # (2,) uint32, draws it; None if no game is to be drawn

    @classmethod
    def random(cls, key: jax.Array, games: int) -> NextGame:
        """Return a random game of the first rows; a key of another generator draws it at once."""
        if games == 1:
            return cls(jnp.zeros((), jnp.int32))
        if str(jax.random.key_impl(key)) == GENERATOR and jax.config.values["jax_threefry_partitionable"]:
            return cls(jnp.full((), NO_GAME - games, jnp.int32), jax.random.key_data(key))
        return cls(_draw(key, games))

    def row(self) -> jax.Array:
        """Return the row of the parameters, () int32; -1 for none."""
        if self.key is None:
            return self.game
        # The bits must not depend on where this is traced: our compiler processes have no options of the user's.
        with jax.threefry_partitionable(True):
            drawn = _draw(jax.random.wrap_key_data(self.key, impl=GENERATOR), jnp.maximum(NO_GAME - self.game, 1))
        return jnp.where(self.game < NO_GAME, drawn, self.game)

    def with_keys(self) -> NextGame:
        """Return the games of many worlds with keys, whether they need them or not."""
        return self if self.key is not None else NextGame(self.game, jnp.zeros((*self.game.shape, 2), jnp.uint32))

    def drawn(self) -> NextGame:
        """Return the games of many worlds, all drawn."""
        return NextGame(jax.vmap(NextGame.row)(self))


def _draw(key: jax.Array, games: jax.Array | int) -> jax.Array:
    return jax.random.randint(key, (), 0, games, jnp.int32)
