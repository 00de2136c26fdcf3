"""Worlds laid out for `unroll`: chunks of lanes, each of one topology, that keep their games."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.features import Features, own_features
from iphyre_jax.envs.params import EnvParams
from iphyre_jax.meshes import most_lanes
from iphyre_jax.physics.types import World
from iphyre_jax.rollouts import Progress

Tree = TypeVar("Tree")

_VECTOR = 16  # lanes come in multiples of a vector register's numbers, or the last ones are played one by one


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Chunk:
    """Worlds of one topology side by side. Every array has lanes behind its own axes."""

    kind: int = field(metadata={"static": True})  # index of the topology in the environment's mixture
    worlds: int = field(metadata={"static": True})  # lanes in use, the first ones; spare ones repeat the last
    game: jax.Array  # () int32, row of the parameters
    world: World
    features: Features
    start: Progress  # before the first step
    progress: Progress  # as it is
    used: jax.Array  # (slots,) bool, slots that a combined plan has executed


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """B worlds under way, sorted by topology, then by game."""

    chunks: tuple[Chunk, ...]

    @classmethod
    def of(cls, environment: Environment, params: EnvParams, games: npt.ArrayLike) -> Batch:
        """Return worlds before their first step (host).

        Args:
            environment: whose episodes they play.
            params: the games.
            games: (B,) integers, rows of the parameters, one for each world, in any order.

        Raises:
            ValueError: games are no such rows; one line.
        """
        rows = np.asarray(games)
        if rows.ndim != 1 or not rows.size or rows.dtype.kind not in "iu":
            raise ValueError(f"games: expected integers, one for each world, got {rows.dtype} of shape {rows.shape}")
        if rows.min() < 0 or rows.max() >= params.games:
            raise ValueError(f"games: expected rows of {params.games} games, got {rows.min()} to {rows.max()}")
        kinds = np.asarray(params.table.kind)[rows]
        chunks: list[Chunk] = []
        with jax.enable_x64(environment.dtype == "float64"):
            for kind in np.unique(kinds).tolist():
                chunks += _chunks(environment, params, kind, np.sort(rows[kinds == kind]))
        return cls(tuple(chunks))

    @property
    def sizes(self) -> tuple[int, ...]:
        """Worlds of each chunk; B together."""
        return tuple(chunk.worlds for chunk in self.chunks)

    @property
    def game(self) -> jax.Array:
        """The game of each world, (B,) int32, rows of the parameters."""
        return joined([chunk.game for chunk in self.chunks], self.sizes, 0)


@partial(jax.jit, static_argnums=(1, 2))
def joined(parts: Sequence[Tree], worlds: tuple[int, ...], axis: int) -> Tree:
    """Join trees of arrays, one for each chunk with all its lanes in an axis, without the spare lanes."""

    def join(*leaves: jax.Array) -> jax.Array:
        used = zip(leaves, worlds, strict=True)
        return jnp.concatenate([jax.lax.slice_in_dim(leaf, 0, count, axis=axis) for leaf, count in used], axis)

    return jax.tree.map(join, *parts)


def _chunks(
    environment: Environment, params: EnvParams, kind: int, rows: npt.NDArray[np.integer[Any]]
) -> Iterator[Chunk]:
    """Lay out worlds of one topology, in chunks of equally many lanes."""
    mixture = environment.mixture
    count = -(-len(rows) // most_lanes())
    lanes = -(-len(rows) // (count * _VECTOR)) * _VECTOR
    tables = jax.tree.map(np.asarray, (params.world, params.features, params.start))
    for begin in range(0, len(rows), lanes):
        here = rows[begin : begin + lanes]
        game = np.concatenate([here, np.repeat(here[-1:], lanes - len(here))])
        world, features, start = jax.tree.map(partial(_in_lanes, game), tables)
        start = _on_device(mixture.progresses[kind].cut, start)
        yield Chunk(
            kind=kind,
            worlds=len(here),
            game=jnp.asarray(game, jnp.int32),
            world=_on_device(mixture.worlds[kind].cut, world),
            features=_on_device(partial(own_features, topology=mixture.topologies[kind]), features),
            start=start,
            progress=start,
            used=jnp.zeros((environment.strategy.slots, lanes), bool),
        )


def _in_lanes(rows: npt.NDArray[np.integer[Any]], table: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.moveaxis(table[rows], 0, -1)


def _on_device(cut: Callable[[Tree], Tree], tree: Tree) -> Tree:
    """Cut off what fills arrays up to the mixture's largest, and put them on the device."""
    return jax.tree.map(jnp.asarray, cut(tree))
