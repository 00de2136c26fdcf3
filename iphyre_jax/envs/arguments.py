"""Checks of what environments and their batches are given, before anything is compiled or allocated."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.checks import check_instance, check_whole, one_line, show
from iphyre_jax.envs.batching.status import GAME
from iphyre_jax.envs.params import EnvParams, Worlds
from iphyre_jax.execution.programs import episode_layout
from iphyre_jax.memory import check_memory

if TYPE_CHECKING:
    from iphyre_jax.envs.core import Environment

_MAX_SIGNATURE = 80  # characters of a policy's signature that are shown
_BYTES_OF_DECISION = 40  # reward, flags and info
_COPIES = 4  # of states and observations: before and after a decision, and on the way


def key_of(seed: int) -> jax.Array:
    """Return the random key of a seed of up to 63 bits, of which `jax.random.key` alone keeps 32."""
    low, high = seed % 2**32, seed // 2**32
    return jax.random.fold_in(jax.random.key(low), high) if high else jax.random.key(low)


@lru_cache(16)
def _raw_key_shape(impl: str) -> tuple[int, ...]:
    """Return the shape of a key that is not typed, by the name of its generator. Worked out once: steps check keys."""
    return jax.eval_shape(lambda: jax.random.key_data(jax.random.key(0, impl=impl))).shape


def check_key(key: Any) -> None:  # noqa: ANN401 - whatever the user took for one
    """Refuse what is not one random key, typed or not; ValueError in one line."""
    dtype: Any = getattr(key, "dtype", None)
    shape = getattr(key, "shape", ())
    if isinstance(key, jax.Array | jax.ShapeDtypeStruct) and jnp.issubdtype(dtype, jax.dtypes.prng_key):
        axes = len(shape)
    elif (
        isinstance(key, jax.Array | np.ndarray | jax.ShapeDtypeStruct)
        and dtype == np.uint32
        and shape[-1:] == _raw_key_shape(jax.config.values["jax_default_prng_impl"])
    ):
        axes = len(shape) - 1
    else:
        raise ValueError(f"key: expected a random key, such as jax.random.key(0), got {show(key)}")
    if axes:
        raise ValueError(f"key: expected one random key, got keys of shape {shape}; jax.vmap plays a batch of worlds")


def check_params(params: object, worlds: Worlds) -> None:
    """Refuse what are not parameters for these worlds; ValueError in one line."""
    if not isinstance(params, EnvParams):
        raise ValueError(f"params: expected the parameters that make has returned, got {show(params)}")
    if params.made_for != worlds.made_for:
        raise ValueError("params: expected those of this environment, got those of another")
    _check_width("params", params, worlds)


def check_state(state: object, params: EnvParams, worlds: Worlds) -> None:
    """Refuse what is not one state of these worlds with parameters for them; ValueError in one line.

    The game of a traced state is not known yet.
    """
    wanted = "a state that reset or step of this environment has returned"
    check_instance("state", state, worlds.state_type, wanted)
    if getattr(state, "state_of", "") != worlds.state_of:
        raise ValueError(f"state: expected {wanted}, got one of another environment")
    words = jax.tree.leaves(state)[0]  # those of the status stand in front, in states of all kinds
    shape = np.shape(words)
    if len(shape) != 1:
        raise ValueError(f"state: expected one state, got states of shape {shape[:-1]}; jax.vmap plays a batch")
    _check_width("state", state, worlds)
    check_params(params, worlds)
    if isinstance(words, jax.Array | np.ndarray) and not isinstance(words, jax.core.Tracer):
        check_row(int(jax.device_get(words)[GAME]), params.n_games)


def check_row(row: int, games: int) -> None:
    """Refuse the game of a state that its parameters do not have; ValueError in one line."""
    if row >= games:
        raise ValueError(f"state: expected a game of these parameters, got row {row} of {games}")


def _check_width(name: str, tree: object, worlds: Worlds) -> None:
    """Refuse arrays of float64 worlds that were cut to 32 bits, as JAX does when it loads them without x64."""
    if worlds.dtype == "float64" and all(leaf.dtype.itemsize < 8 for leaf in jax.tree.leaves(tree)):
        raise ValueError(f"{name}: expected float64, got float32; load it under jax.enable_x64(True)")


def check_arrays(name: str, tree: object) -> None:
    """Refuse a tree with leaves that are no numbers and no arrays, such as names; ValueError in one line."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        if not hasattr(leaf, "dtype") and not isinstance(leaf, bool | int | float | complex):
            where = name + jax.tree_util.keystr(path)
            raise ValueError(f"{where}: expected an array, got {show(leaf)}")


def check_game(name: str, game: object, params: EnvParams, least: int = 0) -> None:
    """Refuse what is no row of checked parameters, of a traced array only type and shape; ValueError in one line."""
    if isinstance(game, jax.Array | np.ndarray) and game.dtype.kind in "iu" and not game.shape:
        if isinstance(game, jax.core.Tracer):
            return
        game = int(game)
    check_whole(name, game, least, params.n_games - 1)


def check_policy(policy: object, takes: tuple[str, ...]) -> None:
    """Refuse what cannot be called with so many arguments, or has no hash; ValueError in one line.

    Args:
        policy: what the caller gave.
        takes: what its arguments are, for the message.
    """
    wanted = f"a function of {', '.join(takes[:-1])} and {takes[-1]}"
    if not callable(policy):
        raise ValueError(f"policy: expected {wanted}, got {show(policy)}")
    try:
        hash(policy)
    except TypeError:
        raise ValueError(f"policy: expected {wanted} that has a hash, got {show(policy)}") from None
    if (signature := _signature(policy)) is None:
        return
    try:
        signature.bind(*takes)
    except TypeError:
        given = one_line(str(signature))[:_MAX_SIGNATURE]
        raise ValueError(f"policy: expected {wanted}, got one of {given}") from None


def _signature(policy: Callable[..., Any]) -> inspect.Signature | None:
    try:
        return inspect.signature(policy)
    except (ValueError, TypeError):  # some callables have none
        return None


def check_batch(name: str, environment: Environment, worlds: int, decisions: int = 0) -> None:
    """Refuse a batch that takes more memory than is free.

    Args:
        name: of the argument that decides the size, for the message.
        environment: that plays.
        worlds: of the batch.
        decisions: whose actions, rewards, flags and infos are kept.

    Raises:
        ValueError: one line with both figures.
    """
    layouts = [episode_layout(topology, environment.dtype) for topology in environment.topologies]
    state = max(layout.rows * layout.word_size for layout in layouts)
    space = environment.observation_space()
    obs = math.prod(space.shape) * np.dtype(space.dtype).itemsize
    decision = _BYTES_OF_DECISION + 4 * math.prod(environment.action_space().shape)
    check_memory(name, worlds * (_COPIES * (state + obs) + decisions * decision), "play fewer worlds at a time")
