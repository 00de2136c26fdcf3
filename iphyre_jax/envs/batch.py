"""Worlds laid out for `unroll`: chunks of lanes, each of one topology, that keep their games."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.features import Features, own_features
from iphyre_jax.envs.mixture import LANES, LANES_OF_DEVICE
from iphyre_jax.envs.params import EnvParams
from iphyre_jax.physics.types import World
from iphyre_jax.rollouts import Progress
from iphyre_jax.scenes import MAX_ELIMINABLE

Tree = TypeVar("Tree")

_VECTOR = 16  # lanes come in multiples of a vector register's numbers, or the last ones are played one by one


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Group:
    """Worlds of one topology. Every array has chunks before and lanes behind its own axes."""

    kind: int = field(metadata={"static": True})  # index of the topology in the environment's mixture
    worlds: int = field(metadata={"static": True})  # those in use, the first ones; spare lanes follow
    game: jax.Array  # () int32, row of the parameters
    world: World
    features: Features
    start: Progress  # before the first step
    progress: Progress  # as it is
    used: jax.Array  # (6,) bool, slots that a combined plan has executed


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """B worlds under way, sorted by topology, then by game."""

    groups: tuple[Group, ...]

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
        return cls(tuple(_group(environment, params, k, np.sort(rows[kinds == k])) for k in np.unique(kinds).tolist()))

    @property
    def worlds(self) -> int:
        """Number of worlds B."""
        return sum(group.worlds for group in self.groups)

    @property
    def game(self) -> jax.Array:
        """The game of each world, (B,) int32, rows of the parameters."""
        return self.by_world([group.game for group in self.groups])

    def by_world(self, parts: Sequence[Tree], axis: int = 0) -> Tree:
        """Join the groups' arrays (chunks, ..., lanes), one tree for each, to arrays with the worlds in one axis."""

        def join(*leaves: jax.Array) -> jax.Array:
            return jnp.concatenate([_in_one_axis(leaf, axis, n) for leaf, n in zip(leaves, sizes, strict=True)], axis)

        sizes = [group.worlds for group in self.groups]
        return jax.tree.map(join, *parts)


def _group(environment: Environment, params: EnvParams, kind: int, rows: npt.NDArray[np.integer[Any]]) -> Group:
    """Lay out worlds of one topology; spare lanes repeat the last one."""
    mixture = environment.mixture
    most = LANES if jax.default_backend() == "cpu" else LANES_OF_DEVICE
    chunks = -(-len(rows) // most)
    lanes = -(-len(rows) // (chunks * _VECTOR)) * _VECTOR
    game = np.concatenate([rows, np.repeat(rows[-1:], chunks * lanes - len(rows))]).reshape(chunks, lanes)

    def laid_out(table: Tree, cut: Callable[[Tree], Tree]) -> Tree:
        """Return rows of a table as chunks of lanes without what fills them up to the mixture's largest."""
        whole = jax.tree.map(np.asarray, table)
        each = [cut(jax.tree.map(lambda leaf: np.moveaxis(leaf[k], 0, -1), whole)) for k in game]  # noqa: B023
        return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *each)

    with jax.enable_x64(environment.dtype == "float64"):
        start = laid_out(params.start, mixture.progresses[kind].cut)
        return Group(
            kind=kind,
            worlds=len(rows),
            game=jnp.asarray(game, jnp.int32),
            world=laid_out(params.world, mixture.worlds[kind].cut),
            features=laid_out(params.features, partial(own_features, topology=mixture.topologies[kind])),
            start=start,
            progress=start,
            used=jnp.zeros((chunks, MAX_ELIMINABLE, lanes), bool),
        )


def _in_one_axis(leaf: jax.Array, axis: int, worlds: int) -> jax.Array:
    """Return an array (chunks, ..., lanes) with chunks and lanes joined to one axis, as long as there are worlds."""
    leaf = jnp.moveaxis(jnp.moveaxis(leaf, 0, -2), (-2, -1), (axis, axis + 1))
    leaf = leaf.reshape(*leaf.shape[:axis], -1, *leaf.shape[axis + 2 :])
    return jax.lax.slice_in_dim(leaf, 0, worlds, axis=axis)
