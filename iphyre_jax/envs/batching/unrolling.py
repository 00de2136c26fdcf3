"""`unroll`: many decisions of many worlds, with the policy inside the program.

    env, params = iphyre_jax.make("on-the-fly/basic-v1")
    batch = Batch.of(env, params, np.repeat(np.arange(params.n_games), 128))

    def policy(weights, key, obs):  # of one world
        logits = network(weights, obs)
        return jax.random.categorical(key, logits), (obs, logits)  # the action, and anything to keep

    batch, steps = unroll(env, policy, weights, batch, jax.random.key(0), decisions=32)

It is a `jax.lax.scan` over `Environment.step_to` in which each world keeps its game.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_instance, check_integers, check_whole, show
from iphyre_jax.envs.arguments import check_arrays, check_batch, check_key, check_params, check_policy
from iphyre_jax.envs.batching.next_game import NO_GAME
from iphyre_jax.envs.core import Environment, Info
from iphyre_jax.envs.params import EnvParams, EnvState
from iphyre_jax.envs.spaces import MAX_AXIS
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.execution.interrupts import as_interrupts

ActingPolicy = Callable[[Any, jax.Array, jax.Array], tuple[jax.Array, Any]]
"""`policy(weights, key, observation) -> action, extras` for one world, in JAX; extras are any tree of arrays."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """B worlds, each in an episode."""

    params: EnvParams
    state: EnvState  # (B, ...)
    obs: jax.Array  # (B, ...) of `state`

    @classmethod
    def of(cls, environment: Environment, params: EnvParams, games: npt.ArrayLike) -> Batch:
        """Return worlds before their first step (host).

        Args:
            environment: that plays the episodes.
            params: the games.
            games: (B,) integers, rows of the parameters, one for each world, in any order.

        Raises:
            ValueError: games are not such rows; one line.
        """
        check_fork()
        check_params(params, environment.worlds)
        rows = check_integers("games", games, "integers, one for each world", 1)
        if not rows.size:
            raise ValueError("games: expected integers, one for each world, got none")
        if rows.min() < 0 or rows.max() >= params.n_games:
            raise ValueError(f"games: expected rows of {params.n_games} games, got {rows.min()} to {rows.max()}")
        check_batch("games", environment, len(rows))
        with jax.enable_x64(environment.dtype == "float64"):
            obs, state = _reset(environment, jnp.asarray(rows, jnp.int32), params)
        return cls(params, state, obs)

    @property
    def game(self) -> jax.Array:
        """The game of each world, (B,) int32, rows of the parameters."""
        return self.state.game


class Steps(NamedTuple):
    """T decisions of B worlds; arrays are (T, B, ...)."""

    action: jax.Array
    reward: jax.Array  # float32
    terminated: jax.Array  # bool, the official flags
    truncated: jax.Array  # bool
    played: jax.Array  # bool, False if the episode had ended before, which happens only without autoreset
    info: Info  # after the decision, before any reset
    extras: Any  # the policy's second result


@partial(jax.jit, static_argnums=0)
def _reset(environment: Environment, games: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
    return jax.vmap(environment.reset_to, in_axes=(0, None))(games, params)


def unroll(
    environment: Environment, policy: ActingPolicy, weights: object, batch: Batch, key: jax.Array, *, decisions: int
) -> tuple[Batch, Steps]:
    """Play so many decisions of a policy in every world; pure.

    Under autoreset a world starts the same game again when its episode ends. So games share the decisions equally, not
    the episodes. Without autoreset an ended episode stays as it is. Played from the start for
    `environment.strategy.decisions`, the most that an episode may take, every world is one whole episode.

    Args:
        environment: of the batch; static.
        policy: see `ActingPolicy`; static: what changes belongs in the weights. Its extras come back in `Steps.extras`.
            Each world has its own key at each decision. An action outside the action space does nothing.
        weights: passed to the policy, any tree of arrays.
        batch: of this environment.
        key: random key.
        decisions: of each world, 1 to 2**31 - 1 if memory allows; static.

    Returns:
        The batch after the decisions, and the steps.

    Raises:
        ValueError: an argument is not as said here, or JAX lacks the environment's dtype; one line.
    """
    check_fork()
    check_instance("environment", environment, Environment, "an environment that make has returned")
    _check_own(batch, environment)
    check_policy(policy, ("weights", "a key", "an observation"))
    check_arrays("weights", weights)
    check_key(key)
    check_batch("decisions", environment, batch.game.shape[0], check_whole("decisions", decisions, 1, MAX_AXIS))
    environment.check_dtype()
    with as_interrupts():
        out: tuple[Batch, Steps] = _unroll(environment, policy, weights, batch, key, decisions=decisions)
    return out


def _check_own(batch: Batch, environment: Environment) -> None:
    """Refuse what is no batch of an environment; ValueError in one line."""
    check_instance("batch", batch, Batch, "a batch, as Batch.of returns it")
    space, worlds = environment.observation_space(), environment.worlds
    is_own = getattr(batch.state, "state_of", "") == worlds.state_of
    if not is_own or (*batch.obs.shape[1:], batch.obs.dtype) != (*space.shape, np.dtype(space.dtype)):
        raise ValueError("batch: expected one of this environment, got one of another")


@partial(jax.jit, static_argnames=("environment", "policy", "decisions"))
def _unroll(
    environment: Environment, policy: ActingPolicy, weights: object, batch: Batch, key: jax.Array, *, decisions: int
) -> tuple[Batch, Steps]:
    """Do what `unroll` says, with checked arguments."""
    keys = jax.random.split(key, batch.game.shape[0])
    game = batch.game if environment.autoreset else jnp.full_like(batch.game, NO_GAME)

    def has_ended(state: EnvState) -> jax.Array:
        return environment.has_ended(environment.worlds.status(batch.params, state))

    def one(state: EnvState, obs: jax.Array, ended: jax.Array, key: jax.Array, game: jax.Array) -> tuple[Any, Steps]:
        decided = policy(weights, key, obs)
        if not isinstance(decided, tuple) or len(decided) != 2:
            raise ValueError(f"policy: expected a pair (action, extras), got {show(decided)}")
        action, extras = decided
        action = environment.action_space().array(action)
        obs, state, reward, terminated, truncated, info = environment.step_to(state, action, batch.params, game)
        # Carried on: a state that is read after its step is copied before it.
        now = state, obs, has_ended(state)
        return now, Steps(action, reward, terminated, truncated, ~ended, info, extras)

    def decide(now: tuple[EnvState, jax.Array, jax.Array], count: jax.Array) -> tuple[Any, Steps]:
        own = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, count)
        return jax.vmap(one)(*now, own, game)

    first = batch.state, batch.obs, jax.vmap(has_ended)(batch.state)
    (state, obs, _), steps = jax.lax.scan(decide, first, jnp.arange(decisions, dtype=jnp.int32))
    return replace(batch, state=state, obs=obs), steps


def unroll_on_threads(
    environment: Environment, policy: ActingPolicy, weights: object, batch: Batch, key: jax.Array, *, decisions: int
) -> tuple[Batch, Steps]:
    """Do what `unroll` does; deprecated: `unroll` plays on all threads."""
    warnings.warn("unroll_on_threads: use unroll, which plays on all threads", DeprecationWarning, stacklevel=2)
    with jax.enable_x64(environment.dtype == "float64"):
        return unroll(environment, policy, weights, batch, key, decisions=decisions)
