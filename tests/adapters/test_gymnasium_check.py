"""Gymnasium's own check finds nothing wrong: one game in `make test`, every id in `make test-environments`."""

from __future__ import annotations

import os
import warnings

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env

import iphyre_jax
from iphyre_jax.adapters import register_gymnasium

ALL = bool(os.environ.get("IPHYRE_JAX_CHECK_ALL"))
SAMPLE = tuple(f"iphyre/{strategy}-support-v1" for strategy in ("in-advance", "on-the-fly", "combined"))


def test_every_id_is_registered() -> None:
    ids = {f"iphyre/{name.replace('/', '-')}" for name in iphyre_jax.environment_ids()}
    assert ids == set(register_gymnasium())
    assert len(ids) >= 3 * (1 + len(iphyre_jax.SPLITS) + 50)  # and what other tests have registered
    assert set(SAMPLE) <= ids


@pytest.mark.slow
@pytest.mark.parametrize("name", register_gymnasium() if ALL else SAMPLE)
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    register_gymnasium()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name, render_mode="rgb_array").unwrapped)
