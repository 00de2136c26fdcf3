"""Many decisions of many worlds at once: the environments at nearly the speed of plain simulation.

`Environment.step` enters the solver anew for each decision: it sorts the batch by topology, looks the scenes up and
turns everything into lanes and back. `unroll` does that once. Its worlds keep their games, so they lie in lanes from
the start, chunk by chunk of one topology each, and within a chunk the policy and the physics take turns.

    env, params = iphyre_jax.make("on-the-fly/basic-v1")
    batch = Batch.of(env, params, np.repeat(np.arange(params.games), 128))

    def policy(key, seen):  # of one world
        logits = network(weights, seen)
        return jax.random.categorical(key, logits), (seen, logits)

    batch, steps = jax.jit(partial(unroll, env, policy, decisions=32))(batch, jax.random.key(0))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.envs import records
from iphyre_jax.envs.batch import Batch, Group
from iphyre_jax.envs.core import Environment, Info
from iphyre_jax.envs.features import standing
from iphyre_jax.envs.mixture import Stretch, play_lanes
from iphyre_jax.rollouts import Progress
from iphyre_jax.scenes.build import timing

ActingPolicy = Callable[[jax.Array, jax.Array], tuple[jax.Array, Any]]
"""`policy(key, observation) -> action, extras` for one world, in JAX; extras are any tree of arrays."""

Tree = TypeVar("Tree")
_Now = tuple[Progress, jax.Array]  # of a chunk: the physics, and the slots that a combined plan has executed


class Steps(NamedTuple):
    """T decisions of B worlds; arrays are (T, B, ...)."""

    action: jax.Array
    reward: jax.Array  # float32
    terminated: jax.Array  # bool, the official flags
    truncated: jax.Array  # bool
    played: jax.Array  # bool, False where the episode had ended before, which happens without autoreset only
    info: Info  # success, fault, eliminations and time after the decision, before any reset
    extras: Any  # what else the policy returned


def observations(environment: Environment, batch: Batch) -> jax.Array:
    """Return what agents see of a batch as it is, (B, ...)."""
    views = [jax.vmap(environment.view)(group.features, group.world, group.progress) for group in batch.groups]
    return batch.by_world(views)


def unroll(
    environment: Environment, policy: ActingPolicy, batch: Batch, key: jax.Array, *, decisions: int
) -> tuple[Batch, Steps]:
    """Let a policy decide so many times in every world; pure, to be used inside `jax.jit`.

    Under autoreset a world whose episode has ended begins anew with the same game, so each game gets an equal share of
    the decisions, not of the episodes, as it would if a game was drawn for each episode. Without autoreset it stays as
    it is; played from the start for as many decisions as an episode may have (`Strategy.decisions`), every world is one
    whole episode.

    Args:
        environment: of the batch; static.
        policy: see `ActingPolicy`; what it returns beside the action comes back in `Steps.extras`. Each world has a key
            of its own at each decision. An action that is no member of the action space does nothing.
        batch: of this environment.
        key: random key.
        decisions: of each world; static.

    Returns:
        The batch as it is then, and the steps.
    """
    if isinstance(decisions, bool) or not isinstance(decisions, int) or decisions < 1:
        raise ValueError(f"decisions: expected a whole number of at least 1, got {decisions!r}")
    groups, parts = [], []
    for group, group_key in zip(batch.groups, jax.random.split(key, len(batch.groups)), strict=True):
        keys = jax.random.split(group_key, group.game.shape)
        play = partial(_play, environment, policy, decisions)
        (progress, used), steps = jax.lax.map(lambda chunk: play(*chunk), (group, keys))  # noqa: B023  # used at once
        groups.append(replace(group, progress=progress, used=used))
        parts.append(steps)
    return Batch(tuple(groups)), batch.by_world(parts, axis=1)


def _play(
    environment: Environment, policy: ActingPolicy, decisions: int, chunk: Group, keys: jax.Array
) -> tuple[_Now, Steps]:
    """Play one chunk, with a key for each lane; arrays of the steps are (T, ..., lanes)."""

    def decide(now: _Now, count: jax.Array) -> tuple[_Now, Steps]:
        return _decide(environment, policy, chunk, now, jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, count))

    return records.scan(decide, (chunk.progress, chunk.used), decisions)


def _decide(
    environment: Environment, policy: ActingPolicy, chunk: Group, now: _Now, keys: jax.Array
) -> tuple[_Now, Steps]:
    """Play one decision of one chunk."""
    before, used = now
    step = before.state.step
    seen = environment.view(chunk.features, chunk.world, before)
    action, extras = jax.vmap(policy, in_axes=(0, -1), out_axes=-1)(keys, seen)
    blocks = standing(chunk.world, before)
    order = environment.strategy.order(action, step, used, blocks, environment.protocol)
    ended = environment.has_ended(before)
    stretch = Stretch(chunk.game, order.plan, jnp.where(ended, step, order.until))
    times = jax.tree.map(jnp.asarray, timing(environment.protocol.fps, environment.dtype))
    topology = environment.mixture.topologies[chunk.kind]
    after = play_lanes(topology, jax.lax.optimization_barrier(times), chunk.world, stretch, before)
    ending = environment.ending(after)
    reward = environment.reward(before.outcome, after.outcome)
    steps = Steps(action, reward, *ending, ~ended, environment.counters(after.outcome), extras)
    used = jnp.where(ended[None], used, order.used)
    if environment.autoreset:
        done = ending.terminated | ending.truncated
        after, used = _where(done, (chunk.start, jnp.zeros_like(used)), (after, used))
    return (after, used), steps


def _where(lanes: jax.Array, yes: Tree, no: Tree) -> Tree:
    """Choose between trees lane by lane."""
    return jax.tree.map(lambda a, b: jnp.where(jnp.broadcast_to(lanes, a.shape), a, b), yes, no)
