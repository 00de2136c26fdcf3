"""Worlds of several topologies in blocks of one each."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.envs.traced.sorting import sort_into_blocks


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
