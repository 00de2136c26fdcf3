"""Observations of many worlds, each as a row: that of its game before the first step, with what has changed since.

A CPU copies and masks a row in a few vectors. `vectors.observe` computes all numbers in lanes, for a GPU, and they are
turned over afterwards. Both give the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.layout import BIT, FLAGS, pack_flags, pack_numbers, write_columns
from iphyre_jax.observations.features import Features, Pose, motion_size, rows_size, scaled_ends
from iphyre_jax.observations.official import COLUMNS, JOINT_COLUMN, SPRING_COLUMN
from iphyre_jax.observations.vectors import ObservationName, motion_inputs
from iphyre_jax.rollouts import FAULT_NOT_FINITE, EpisodeState

VECTORS = 32  # numbers of the two widest vectors, which LLVM takes together
Words = list[jax.Array]  # a set of objects as bits, (lanes,) int32 each


class ObsPatch(NamedTuple):
    """What has changed in observations since their games began; lanes behind."""

    present: Words  # objects that are not removed; none in a world that is no longer finite
    joined: Words  # objects of joints that remain; no words without joints
    sprung: Words  # objects of springs that remain
    mover: jax.Array  # (n,) int32, object of each moving body
    ends: jax.Array  # (n, 4) float32, see `scaled_ends`
    motion: jax.Array | None  # see `features.motion`


def obs_patch(
    observation: ObservationName,
    features: Features,
    present_slots: jax.Array,
    episode: EpisodeState,
    steps: jax.Array,
) -> ObsPatch:
    """Return what `write_observations` needs of worlds; lanes stand behind the numbers.

    Args:
        observation: see `vectors.obs_inputs`.
        features: of the scenes; `obs_rows` and `candidates` are not read.
        present_slots: (slots,) bool, plan slots whose block is present.
        episode: of the worlds.
        steps: () physics steps of a whole episode.
    """
    state, sound = episode.state, episode.result.fault != FAULT_NOT_FINITE
    removed = pack_numbers(features.slot_object, ~present_slots, features.objects)
    present = [jnp.where(sound, ~word, 0) for word in removed]
    unread = jnp.zeros((0, *sound.shape), bool)
    pose = Pose(state.position.x, state.position.y, state.angle, unread, sound)

    ends = jnp.stack(scaled_ends(features.ends, pose))
    return ObsPatch(
        present,
        _tied(features.joints, present),
        _tied(features.springs, present),
        features.mover,
        jnp.where(sound, ends, jnp.zeros((), jnp.float32)),
        motion_inputs(observation, features, pose, state.motion, state.step, steps),
    )


def _tied(pairs: jax.Array, present: Words) -> Words:
    """Return the objects of pairs, (pairs, objects) bool, whose objects are all present."""
    tied = [jnp.zeros_like(word) for word in present] if len(pairs) else []
    for pair in map(pack_flags, pairs):
        remains = reduce(jnp.logical_and, [(both & ~here) == 0 for both, here in zip(pair, present, strict=True)])
        tied = [jnp.where(remains, word | both, word) for word, both in zip(tied, pair, strict=True)]
    return tied


def write_observations(
    out: jax.Array,
    world: jax.Array,
    count: jax.Array,
    starts: jax.Array,
    game: jax.Array,
    patch: ObsPatch,
    objects: int,
) -> jax.Array:
    """Return `out`, (B, size), with the observations of the first lanes written into it; traced, for a CPU.

    Args:
        out: observations, one world a row.
        world: (lanes,) int32, row of each lane's world.
        count: () int32, lanes to write.
        starts: (games, size), observations before the first step.
        game: (lanes,) int32, row of each lane's game.
        patch: of the lanes.
        objects: rows of the official table.
    """
    sets, size = [patch.present, patch.joined, patch.sprung], out.shape[1]
    words = jnp.stack([word for each in sets for word in each])
    bits, always = _deciding([len(each) for each in sets], objects, size)
    ends = patch.ends.reshape(-1, patch.ends.shape[-1])
    # What whole vectors leave would be scalar code.
    pieces = (0, size - size % VECTORS), (size - VECTORS, size)

    def write(lane: jax.Array, out: jax.Array) -> jax.Array:
        own = jax.lax.dynamic_slice_in_dim(words, lane, 1, axis=1)
        for first, last in pieces:
            start = jax.lax.dynamic_slice(starts, (game[lane], jnp.int32(first)), (1, last - first))
            decided = [own[k] & bits[k, first:last] for k in range(len(words))]
            stays = reduce(jnp.bitwise_or, decided, jnp.asarray(always[first:last])) != 0
            row = jax.lax.optimization_barrier(jnp.where(stays[None], start, jnp.zeros_like(start)))
            out = jax.lax.dynamic_update_slice(out, row, (world[lane], jnp.int32(first)))
        for body in range(patch.mover.shape[0]):
            placed = jax.lax.dynamic_slice(ends, (jnp.int32(4 * body), lane), (4, 1))
            out = jax.lax.dynamic_update_slice(out, placed.T, (world[lane], COLUMNS * patch.mover[body, lane]))
        return out

    out = jax.lax.fori_loop(0, count, write, out)
    if patch.motion is None:
        return out
    return write_columns(patch.motion, out, world, count, size - motion_size(objects))


def _deciding(words: Sequence[int], objects: int, size: int) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return which bits decide whether the numbers of an observation stay: of each word, (words, size), and of none.

    No flags, with which XLA's code would be scalar: the second array has a bit set for each number that always stays.

    Args:
        words: of the objects that are present, of those joined, of those sprung.
        objects: rows of the official table.
        size: of an observation.
    """
    row, column = np.divmod(np.arange(rows_size(objects)), COLUMNS)
    word = row // FLAGS
    for kind, of_kind in enumerate((JOINT_COLUMN, SPRING_COLUMN), 1):
        if words[kind]:
            word[column == of_kind] += sum(words[:kind])
    bits = np.zeros((sum(words), size), np.int32)
    bits[word, np.arange(len(row))] = BIT[row % FLAGS]
    always: npt.NDArray[np.int32] = np.where(bits.any(axis=0), np.int32(0), np.int32(1))
    return bits, always
