"""Worlds of several topologies in order, and in blocks of one each."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.envs.traced.sorting import sort_by_game, sort_into_blocks


@pytest.mark.parametrize(
    ("worlds", "topologies", "lanes"), [(1, 7, 32), (5, 2, 4), (64, 3, 32), (100, 7, 8), (33, 1, 32)]
)
def test_a_block_has_worlds_of_its_topology(worlds: int, topologies: int, lanes: int) -> None:
    sort = jax.jit(sort_into_blocks, static_argnums=(1, 2))
    rng = np.random.default_rng(0)
    for used in range(1, topologies + 1):  # also with topologies of no world, first ones and last ones
        topology_id = rng.choice(rng.permutation(topologies)[:used], worlds).astype(np.int32)
        found = jax.tree.map(np.asarray, sort(jnp.asarray(topology_id), topologies, lanes))
        assert found.read.shape == (len(found.topology_id) * lanes,)
        np.testing.assert_array_equal(topology_id[found.read], np.repeat(found.topology_id, lanes))
        np.testing.assert_array_equal(found.read[found.place], np.arange(worlds))


@pytest.mark.parametrize(("worlds", "games"), [(1, 1), (9, 1), (64, 40), (40_000, 30_000)])
def test_worlds_are_ordered_by_topology_and_game(worlds: int, games: int) -> None:
    """Of 30,000 games and 40,000 worlds a number is too small to hold the game too."""
    rng = np.random.default_rng(1)
    topologies = min(games, 3)
    topology_id, row = rng.integers(0, topologies, games), rng.integers(0, games, worlds)
    given = (jnp.asarray(part, jnp.int32) for part in (topology_id, row))
    order, last = map(np.asarray, sort_by_game(*given, topologies))
    np.testing.assert_array_equal(np.sort(order), np.arange(worlds))
    own = topology_id[row]
    np.testing.assert_array_equal(own[order], np.sort(own))
    np.testing.assert_array_equal(last, np.searchsorted(np.sort(own), np.arange(topologies), side="right"))
    if games < 100:
        np.testing.assert_array_equal(order, np.lexsort((row, own)))
