"""The cache of observations: what it holds never shows."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.batching.unrolling import Batch, unroll
from iphyre_jax.envs.host import observations


def random_action(weights: Any, key: jax.Array, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
    del weights
    return jax.random.randint(key, (), 0, 7), obs


def observed() -> Any:
    """Observations of 20 decisions of random agents in the basic games."""
    env, params = iphyre_jax.make("on-the-fly/basic-v1", backend="host")
    batch = Batch.of(env, params, np.arange(40) % params.n_games)
    return np.asarray(unroll(env, random_action, (), batch, jax.random.key(0), decisions=20)[1].extras)


@pytest.mark.parametrize("name", ["MOST_NUMBERS", "CACHED"])
def test_a_small_cache_gives_the_same_observations(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    emptied, rows = set(), []
    find, made = observations.HostObservations._find, observations.HostObservations._row

    def find_anew(self: observations.HostObservations, *given: Any) -> Any:
        if self not in emptied:
            emptied.add(self)
            self._cache = self._empty
        return find(self, *given)

    monkeypatch.setattr(observations.HostObservations, "_find", find_anew)
    monkeypatch.setattr(observations.HostObservations, "_row", lambda *given: rows.append(given) or made(*given))
    expected, enough = observed(), len(rows)
    monkeypatch.setattr(observations, name, 40)
    emptied.clear()
    np.testing.assert_array_equal(observed(), expected)
    assert len(rows) > 2 * enough > 0  # some were made again
