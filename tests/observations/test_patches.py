"""Observations as rows: the same numbers as `observe` computes in lanes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.observations.features import Features, Pose, present_objects
from iphyre_jax.observations.patches import obs_patch, write_observations
from iphyre_jax.observations.vectors import ObservationName, obs_inputs, observe
from iphyre_jax.physics.types import Motion, Topology, World
from iphyre_jax.physics.vector import Vec
from iphyre_jax.rollouts import FAULT_NOT_FINITE, reset_episode

WORLDS, LANES, GAMES = 7, 5, 3
WORLD, GAME = np.array([4, 0, 6, 2, 2], np.int32), np.array([2, 0, 1, 1, 0], np.int32)
COUNT = 4  # the last lane is spare
STEPS = 150


def made_up(objects: int, slots: int, ties: int, rng: np.random.Generator) -> Features:
    """Games of random numbers: a bar and a ball move, the last two objects are missing."""
    rows = rng.random((GAMES, objects, 9)).astype(np.float32)
    rows[:, :, 7:] = 0
    rows[:, -2:] = 0
    pairs = np.argsort(rng.random((2, GAMES * ties, objects - 2)))[:, :, :2]
    joints, springs = ((np.arange(objects) == pair[..., None]).any(1).reshape(GAMES, ties, objects) for pair in pairs)
    for column, tied in ((7, joints), (8, springs)):
        rows[:, :, column] = tied.any(1)
    movers = np.stack([rng.permutation(objects - 2)[:2] for _ in range(GAMES)]).astype(np.int32)
    blocks = np.stack([rng.permutation(objects - 2)[:slots] for _ in range(GAMES)]).astype(np.int32)
    blocks = np.where((blocks[..., None] == movers[:, None]).any(-1), -1, blocks)
    ends, candidates = rng.normal(size=(GAMES, 1, 2, 2)) * 40, rng.random((GAMES, slots, 2))
    return Features(None, *map(jnp.asarray, (rows, movers, np.float32(ends), blocks, joints, springs, candidates)))


@pytest.mark.parametrize(("objects", "slots", "ties"), [(12, 6, 0), (12, 6, 2), (40, 35, 1)])
@pytest.mark.parametrize("observation", ["official", "motion"])
def test_rows_are_what_is_computed_in_lanes(objects: int, slots: int, ties: int, observation: ObservationName) -> None:
    rng = np.random.default_rng(objects + ties)
    features = made_up(objects, slots, ties, rng)
    topology, none = Topology(1, 1, 10, (), (), 12), jnp.zeros(LANES, bool)
    world = jax.tree.map(lambda leaf: jnp.zeros((*leaf.shape, LANES), leaf.dtype), World.shapes(topology, "float32"))
    start = reset_episode(topology, world, none)
    own: Any = jax.tree.map(lambda leaf: jnp.moveaxis(leaf[GAME], 0, -1), features)

    def of(episode: Any, present: Any, sound: Any) -> tuple[jax.Array, Any]:
        """The observations in lanes, and what is written as rows."""
        state = episode.state
        pose = Pose(state.position.x, state.position.y, state.angle, present_objects(own, present), sound)
        inputs = obs_inputs(observation, own, pose, state.motion, state.step, jnp.asarray(STEPS))
        return observe(own, inputs, no_op=True), obs_patch(observation, own, present, episode, jnp.asarray(STEPS))

    first, _ = of(start, jnp.ones((slots, LANES), bool), ~none)
    starts = jnp.zeros((GAMES, first.shape[0]), jnp.float32).at[GAME].set(first.T)
    numbers = rng.random((8, topology.moving, LANES)).astype(np.float32)
    motion = Motion(Vec(numbers[0], numbers[1]), numbers[2], Vec(numbers[3], numbers[4]), numbers[5])
    place = Vec(numbers[6] * 700 - 50, numbers[7] * 700 - 50)
    state = replace(start.state, position=place, angle=numbers[2], motion=motion, step=jnp.full(LANES, 40, jnp.int32))
    fault = np.array([0, FAULT_NOT_FINITE, 0, 0, 0], np.int32)
    now = replace(start, state=state, result=replace(start.result, fault=jnp.asarray(fault)))
    present = jnp.asarray(rng.random((slots, LANES)) < 0.6)
    lanes, patch = jax.jit(lambda episode: of(episode, present, fault == 0))(now)
    before = rng.random((WORLDS, lanes.shape[0])).astype(np.float32)
    given = jnp.asarray(WORLD), jnp.int32(COUNT), starts, jnp.asarray(GAME), patch, objects
    rows = jax.jit(lambda out: write_observations(out, *given))(before)
    expected = before.copy()
    expected[WORLD[:COUNT]] = np.asarray(lanes).T[:COUNT]
    np.testing.assert_array_equal(rows, expected)
    assert (np.asarray(lanes)[: 9 * objects, 1] == 0).all()
    assert not ties or np.asarray(patch.joined).any()
