"""What the calls are given beside the bad argument; nothing of it is compiled."""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from functools import cache
from pathlib import Path
from tempfile import gettempdir
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np

import iphyre_jax
from iphyre_jax import adapters, compat, envs, physics, scenes
from iphyre_jax.cli import main


@cache
def made() -> tuple[iphyre_jax.Environment, iphyre_jax.EnvParams]:
    """Return an environment of one game."""
    return iphyre_jax.make(ID)


@cache
def state() -> Any:
    """Return the shapes of a state; nothing is played."""
    env, params = made()
    with warnings.catch_warnings(action="ignore"):  # of the program that would play it
        return jax.eval_shape(env.reset, KEY, params)[1]


@cache
def batch() -> envs.Batch:
    """Return a batch of two worlds; nothing is compiled."""
    env, params = made()
    shapes = jax.eval_shape(jax.vmap(env.reset_to, in_axes=(0, None)), np.zeros(2, np.int32), params)
    obs, two = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
    return envs.Batch(params, two, obs)


@cache
def world() -> tuple[physics.Topology, physics.World, physics.Timing]:
    """Return the parts of a game."""
    return *iphyre_jax.compile_scene(hole(), dtype="float32"), iphyre_jax.step_timing(60, "float32")


def hole() -> iphyre_jax.Scene:
    """Return a game."""
    return iphyre_jax.load_scene("hole")


@cache
def simulator() -> compat.IPHYRE:
    """Return the official class with a world that is never played."""
    made = compat.IPHYRE("hole")
    made._world = SimpleNamespace(alive=np.ones(12, bool), features=SimpleNamespace(position=np.zeros((12, 2))))  # type: ignore[assignment]
    return made


@cache
def single() -> adapters.GymnasiumEnv:
    """Return an environment of gymnasium."""
    return adapters.GymnasiumEnv(ID)


@cache
def vector() -> adapters.GymnasiumVectorEnv:
    """Return two of them."""
    return adapters.GymnasiumVectorEnv(ID, 2)


def command(*words: object) -> None:
    """Run the command line; raise a ValueError with what it prints if it refuses.

    The parser explains an option of a wrong type in a box, which is not repeated here.
    """
    text = io.StringIO()
    with contextlib.redirect_stderr(text), contextlib.redirect_stdout(io.StringIO()):
        code = main.run([str(word) for word in words])
    if code != main.ERROR:
        raise AssertionError(f"exit code {code}")
    said = text.getvalue().strip()
    raise ValueError(said if said.startswith("iphyre-jax: ") else f"{words}: refused by the parser")


ID = "in-advance/support-v1"
KEY = jax.random.key(0)
PLAN = [[-1, -1]]
OUT = Path(gettempdir()) / f"iphyre-{os.getpid()}.png"


def policy(key: jax.Array, obs: jax.Array) -> jax.Array:
    """Choose nothing."""
    del key
    return obs[:6] * 0


def acting(weights: object, key: jax.Array, obs: jax.Array) -> tuple[jax.Array, tuple[()]]:
    """Choose nothing."""
    del weights
    return policy(key, obs), ()


def scene_file() -> str:
    """Return the path of a scene file."""
    path = OUT.with_suffix(".json")
    scenes.write_scene(hole(), path)
    return str(path)
