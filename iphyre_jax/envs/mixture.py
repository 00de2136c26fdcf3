"""Worlds of several topologies in one program.

A topology decides what is compiled, so a batch that mixes games needs one program for each of them, and arrays of one
shape for all. `Mixture` gives both: every array of a world is filled up with rows at its end to the largest of the
mixture; `play` cuts off the rows that are not the world's own, runs its topology's program and fills up again. So each
world is computed as it would be in a batch of its own kind.

`play` is written for one world. Under `jax.vmap`, nested or not, it does not become "play every topology for every
world and select": the worlds are sorted by topology and played in chunks of lanes (trailing axes, see `physics.types`),
each chunk by the program of its own topology.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import Progress, begin, play_step

Tree = TypeVar("Tree")
Play = Callable[[Timing, "Games", "Stretch", Progress], Progress]
Branch = Callable[["Stretch", Progress], Progress]

LANES = 128  # worlds a chunk on a CPU: their state stays in the cache of a core
LANES_OF_DEVICE = 8192  # on an accelerator, which wants many at once


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Games:
    """A table of worlds, filled up, one a row of every array."""

    world: World
    kind: jax.Array  # (games,) int32, index into the mixture's topologies


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Stretch:
    """What one world is to play next."""

    game: jax.Array  # () int32, row of the table
    plan: jax.Array  # (slots,) int32, the 0-based step before which a block goes; -1 or a step gone by: it stays
    until: jax.Array  # () int32, play until so many steps are made or the episode is over


@dataclass(frozen=True)
class Rows:
    """The shapes of all arrays of a tree, hashable."""

    structure: Any  # jax.tree_util.PyTreeDef
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, tree: object) -> Rows:
        """Return the shapes of a tree of arrays."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(structure, tuple(tuple(leaf.shape) for leaf in leaves))

    @classmethod
    def largest(cls, many: Sequence[Rows]) -> Rows:
        """Return the least shapes that hold those of every tree."""
        columns = zip(*(rows.shapes for rows in many), strict=True)
        return cls(many[0].structure, tuple(tuple(np.max(shapes, axis=0).tolist()) for shapes in columns))

    def cut(self, tree: Tree) -> Tree:
        """Return the first rows of every array; lanes, behind the rows, stay."""
        leaves = self.structure.flatten_up_to(tree)
        cut = [leaf[tuple(slice(n) for n in shape)] for shape, leaf in zip(self.shapes, leaves, strict=True)]
        return self.structure.unflatten(cut)

    def fill(self, tree: Tree) -> Tree:
        """Return every array with rows of zeros behind its own; lanes, behind the rows, stay."""
        leaves = self.structure.flatten_up_to(tree)
        return self.structure.unflatten([_fill(leaf, shape) for shape, leaf in zip(self.shapes, leaves, strict=True)])


def _fill(leaf: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    missing = [(0, n - leaf.shape[axis]) for axis, n in enumerate(shape)]
    lanes = [(0, 0)] * (leaf.ndim - len(shape))
    return jnp.pad(leaf, missing + lanes) if any(n for _, n in missing) else leaf


@dataclass(frozen=True)
class Mixture:
    """The topologies that one program plays; hashable, hence static under `jax.jit`.

    Attributes:
        topologies: in the order in which `Games.kind` counts them.
        worlds: shapes of a world of each.
        progresses: shapes of its progress.
    """

    topologies: tuple[Topology, ...]
    worlds: tuple[Rows, ...]
    progresses: tuple[Rows, ...]

    @classmethod
    def of(cls, built: Sequence[tuple[Topology, World]]) -> Mixture:
        """Return the mixture of some worlds, at least one."""
        first = dict(reversed(built))
        topologies = tuple(dict.fromkeys(topology for topology, _ in built))
        starts = (jax.eval_shape(partial(start, topology), first[topology]) for topology in topologies)
        return cls(topologies, tuple(Rows.of(first[t]) for t in topologies), tuple(map(Rows.of, starts)))

    @property
    def world(self) -> Rows:
        """The shapes of a world filled up."""
        return Rows.largest(self.worlds)

    @property
    def progress(self) -> Rows:
        """The shapes of a progress filled up."""
        return Rows.largest(self.progresses)

    def play(self, timing: Timing, games: Games, stretch: Stretch, progress: Progress) -> Progress:
        """Play one world until `stretch.until` steps are made or its episode is over; one that is over stays as it is.

        Args:
            timing: of the physics step; not to be mapped over.
            games: the table.
            stretch: of one world.
            progress: of the world, filled up.
        """
        return _vmappable(self)(timing, games, stretch, progress)


@partial(jax.jit, static_argnums=0)
def start(topology: Topology, world: World) -> Progress:
    """Return the episode of one world of a topology before its first step."""
    return begin(topology, world, jnp.zeros((), bool))


def play_lanes(topology: Topology, timing: Timing, world: World, stretch: Stretch, progress: Progress) -> Progress:
    """Play worlds of one topology, each from its own clock to its own end; lanes may stand behind every row.

    Unlike `rollouts.advance`, which plays all lanes from one common step, a lane waits here while others play on.
    """
    removal = jnp.full_like(world.column, -1)
    for slot in range(stretch.plan.shape[0]):
        removal = jnp.where(world.column == slot, jnp.expand_dims(stretch.plan[slot], 0), removal)

    def waits(progress: Progress) -> jax.Array:
        return progress.outcome.over | (progress.state.step >= stretch.until)

    def once(old: Progress) -> Progress:
        waiting = waits(old)
        # A waiting lane is played as one that is over, which costs the others nothing, and then put back.
        marked = replace(old, outcome=replace(old.outcome, over=waiting))
        due = removal == jnp.expand_dims(old.state.step, 0)
        new = play_step(topology, world, timing, marked, due)
        return jax.tree.map(lambda was, now: jnp.where(jnp.broadcast_to(waiting, now.shape), was, now), old, new)

    return jax.lax.while_loop(lambda progress: ~jnp.all(waits(progress)), once, progress)


@cache
def _vmappable(mixture: Mixture) -> Play:
    """Return `play` of a mixture, which takes one world or a batch of them on a leading axis."""
    play = custom_vmap(jax.jit(partial(_play, mixture)))

    @play.def_vmap
    def batched(
        size: int, mapped: Sequence[object], timing: Timing, games: Games, stretch: Stretch, progress: Progress
    ) -> tuple[Progress, Progress]:
        if any(jax.tree.leaves(mapped[0])):
            raise ValueError("timing: expected the same for all worlds of a batch, got one that is mapped over")

        def with_axis(leaf: jax.Array, has_axis: bool) -> jax.Array:
            return leaf if has_axis else jnp.broadcast_to(leaf, (size, *leaf.shape))

        stretch, progress = jax.tree.map(with_axis, (stretch, progress), tuple(mapped[2:]))
        if any(jax.tree.leaves(mapped[1])):  # a table for each: one below the other
            games = jax.tree.map(with_axis, games, mapped[1])
            each = games.kind.shape[1]
            games = jax.tree.map(lambda leaf: leaf.reshape(size * each, *leaf.shape[2:]), games)
            first = each * jnp.arange(size, dtype=jnp.int32)
            stretch = replace(stretch, game=stretch.game + first.reshape(size, *(1,) * (stretch.game.ndim - 1)))
        batch = stretch.game.shape
        count = math.prod(batch)
        flat = jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[len(batch) :]), (stretch, progress))
        out = jax.tree.map(lambda leaf: leaf.reshape(*batch, *leaf.shape[1:]), play(timing, games, *flat))
        return out, jax.tree.map(lambda _: True, out)

    return play


def _play(mixture: Mixture, timing: Timing, games: Games, stretch: Stretch, progress: Progress) -> Progress:
    """Play one world, or a batch on the leading axis."""
    branches = [partial(_play_kind, mixture, kind, timing, games.world) for kind in range(len(mixture.topologies))]
    if stretch.game.ndim == 0:
        return jax.lax.switch(games.kind[stretch.game], branches, stretch, progress)
    size = stretch.game.shape[0]
    lanes = min(size, LANES if jax.default_backend() == "cpu" else LANES_OF_DEVICE)
    if len(branches) == 1:
        return _play_slices(branches[0], lanes, stretch, progress)
    return _play_sorted(branches, lanes, games.kind[stretch.game], stretch, progress)


def _play_kind(
    mixture: Mixture, kind: int, timing: Timing, worlds: World, stretch: Stretch, progress: Progress
) -> Progress:
    """Play worlds, lanes behind their rows, that all are of one topology of the mixture."""
    own = mixture.worlds[kind]
    one = jax.tree.leaves(worlds)[0].shape[0] == 1

    def in_lanes(leaf: jax.Array) -> jax.Array:
        if one:  # nothing to look up, and the same number in all lanes
            rows = leaf[0].reshape(*leaf.shape[1:], *(1,) * stretch.game.ndim)
            return jnp.broadcast_to(rows, (*leaf.shape[1:], *stretch.game.shape))
        return jnp.moveaxis(leaf[stretch.game], 0, -1) if stretch.game.ndim else leaf[stretch.game]

    world = own.cut(jax.tree.map(in_lanes, worlds))
    after = play_lanes(mixture.topologies[kind], timing, world, stretch, mixture.progresses[kind].cut(progress))
    return mixture.progress.fill(after)


def _play_slices(branch: Branch, lanes: int, stretch: Stretch, progress: Progress) -> Progress:
    """Play a batch of worlds of one topology, slice by slice."""
    size = stretch.game.shape[0]
    if size == lanes:
        return _as_batch(branch(*_as_lanes((stretch, progress))))

    def play(k: jax.Array, whole: Progress) -> Progress:
        begin = jnp.minimum(k * lanes, size - lanes)  # worlds that the last slice has again are done and wait
        part = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, begin, lanes), (stretch, whole))
        after = _as_batch(branch(*_as_lanes(part)))
        return jax.tree.map(lambda leaf, new: jax.lax.dynamic_update_slice_in_dim(leaf, new, begin, 0), whole, after)

    return jax.lax.fori_loop(0, -(-size // lanes), play, progress)


def _play_sorted(
    branches: Sequence[Branch], lanes: int, kind: jax.Array, stretch: Stretch, progress: Progress
) -> Progress:
    """Play a batch of worlds of several topologies, sorted into chunks of one topology each."""
    size = stretch.game.shape[0]
    chunks = _chunks(kind, len(branches), lanes)

    def play(k: jax.Array, whole: Progress) -> Progress:
        kind, rows = chunks.at(k)
        part, before = jax.tree.map(lambda leaf: leaf.at[rows].get(mode="clip"), (stretch, whole))
        part = replace(part, until=jnp.where(rows < size, part.until, 0))  # a spare lane waits from the start
        after = _as_batch(jax.lax.switch(kind, branches, *_as_lanes((part, before))))
        return jax.tree.map(
            lambda leaf, new: leaf.at[rows].set(new, mode="drop", unique_indices=True, indices_are_sorted=True),
            whole,
            after,
        )

    return jax.lax.fori_loop(0, chunks.count, play, progress)


def _as_lanes(tree: Tree) -> Tree:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), tree)


def _as_batch(tree: Tree) -> Tree:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


@dataclass(frozen=True)
class _Chunks:
    """The worlds of a batch in chunks of one kind each."""

    order: jax.Array  # (size,) int32, the worlds sorted by kind
    size: jax.Array  # (kinds,) int32, worlds of each
    before: jax.Array  # (kinds,) int32, worlds of the kinds before it
    last: jax.Array  # (kinds,) int32, chunks up to the last of a kind, it included
    lanes: int

    @property
    def count(self) -> jax.Array:
        """The number of chunks, () int32."""
        return self.last[-1]

    def at(self, k: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the kind of chunk k and its worlds, (lanes,) int32, rising; spare ones lie beyond the batch."""
        kind = jnp.sum((k >= self.last).astype(jnp.int32), dtype=jnp.int32)
        of_kind = -(-self.size[kind] // self.lanes)
        place = (k - self.last[kind] + of_kind) * self.lanes + jnp.arange(self.lanes, dtype=jnp.int32)
        rows = self.order.at[self.before[kind] + place].get(mode="clip")
        return kind, jnp.where(place < self.size[kind], rows, self.order.shape[0] + place)


def _chunks(kind: jax.Array, kinds: int, lanes: int) -> _Chunks:
    order = jnp.arange(kind.shape[0], dtype=jnp.int32)
    if kinds > 1:
        order = jnp.argsort(kind, stable=True).astype(jnp.int32)
    size = jnp.stack([jnp.sum(kind == k, dtype=jnp.int32) for k in range(kinds)])
    total = jnp.cumsum(size, dtype=jnp.int32)
    return _Chunks(order, size, total - size, jnp.cumsum(-(-size // lanes), dtype=jnp.int32), lanes)
