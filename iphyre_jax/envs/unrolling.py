"""Many decisions of many worlds at once: the environments at nearly the speed of plain simulation.

`Environment.step` enters the solver anew for each decision: it sorts the batch by topology, looks the scenes up and
turns everything into lanes and back. `unroll` does that once. Its worlds keep their games, so they lie in lanes from
the start, chunk by chunk of one topology each, and within a chunk the policy and the physics take turns.

    env, params = iphyre_jax.make("on-the-fly/basic-v1")
    batch = Batch.of(env, params, np.repeat(np.arange(params.games), 128))

    def policy(weights, key, seen):  # of one world
        logits = network(weights, seen)
        return jax.random.categorical(key, logits), (seen, logits)  # the action, and what is to be kept

    batch, steps = unroll_on_threads(env, policy, weights, batch, jax.random.key(0), decisions=32)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.envs import records
from iphyre_jax.envs.batch import Batch, Chunk, joined
from iphyre_jax.envs.core import Environment, Info
from iphyre_jax.envs.features import standing
from iphyre_jax.envs.stretches import Stretch, play_lanes
from iphyre_jax.programs import run_all
from iphyre_jax.rollouts import Progress
from iphyre_jax.scenes.build import timing

ActingPolicy = Callable[[Any, jax.Array, jax.Array], tuple[jax.Array, Any]]
"""`policy(weights, key, observation) -> action, extras` for one world, in JAX; extras are any tree of arrays."""

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
    views = [environment.view(chunk.features, chunk.world, chunk.progress) for chunk in batch.chunks]
    return joined([jnp.moveaxis(view, -1, 0) for view in views], batch.sizes, 0)


def unroll(
    environment: Environment, policy: ActingPolicy, weights: object, batch: Batch, key: jax.Array, *, decisions: int
) -> tuple[Batch, Steps]:
    """Let a policy decide so many times in every world; pure, to be used inside `jax.jit`.

    Under autoreset a world whose episode has ended begins anew with the same game, so each game gets an equal share of
    the decisions, not of the episodes, as it would if a game was drawn for each episode. Without autoreset it stays as
    it is; played from the start for as many decisions as an episode may take (`environment.strategy.decisions`), every
    world is one whole episode.

    Args:
        environment: of the batch; static.
        policy: see `ActingPolicy`; what it returns beside the action comes back in `Steps.extras`. Each world has a key
            of its own at each decision. An action that is no member of the action space does nothing.
        weights: given to the policy, any tree of arrays.
        batch: of this environment.
        key: random key.
        decisions: of each world; static.

    Returns:
        The batch as it is then, and the steps.

    Raises:
        ValueError: decisions is no whole number of at least 1, or a float64 environment meets a JAX without x64; one
            line.
    """
    _check(decisions)
    environment.check_dtype()
    play = partial(_play, environment, policy, decisions, weights)
    jobs = zip(batch.chunks, jax.random.split(key, len(batch.chunks)), strict=True)
    played: list[tuple[_Now, Steps]] = []
    for _, alike in groupby(jobs, lambda job: job[0].kind):  # one loop over all chunks of a topology
        # They may differ in the number of spare lanes, which is nothing to the loop.
        each = [(replace(chunk, worlds=0), chunk_key) for chunk, chunk_key in alike]
        many = jax.lax.map(lambda job: play(*job), jax.tree.map(lambda *leaves: jnp.stack(leaves), *each))
        played += [jax.tree.map(lambda leaf: leaf[k], many) for k in range(len(each))]  # noqa: B023  # used at once
    return _joined(batch, played)


def unroll_on_threads(
    environment: Environment, policy: ActingPolicy, weights: object, batch: Batch, key: jax.Array, *, decisions: int
) -> tuple[Batch, Steps]:
    """Do what `unroll` does, chunk by chunk on all threads that `configure` allows (host).

    Each topology has a program of its own, and programs are compiled side by side, when first asked for. The policy
    must be the same function each time, or they are compiled again: what changes belongs in the weights.
    """
    _check(decisions)

    def play(job: tuple[Chunk, jax.Array]) -> tuple[_Now, Steps]:
        program = environment, policy, decisions, job[0].kind
        with _LOCKS.setdefault(program, Lock()):  # or several threads would compile the same program
            if program not in _COMPILED:
                _run(environment, policy, decisions, weights, *job)
                _COMPILED.add(program)
        return _run(environment, policy, decisions, weights, *job)

    jobs = zip(batch.chunks, jax.random.split(key, len(batch.chunks)), strict=True)
    return _joined(batch, run_all(play, jobs))


_LOCKS: dict[tuple[object, ...], Lock] = {}
_COMPILED: set[tuple[object, ...]] = set()


def _run(
    environment: Environment, policy: ActingPolicy, decisions: int, weights: object, chunk: Chunk, key: jax.Array
) -> tuple[_Now, Steps]:
    with jax.enable_x64(environment.dtype == "float64"):  # a thread has settings of its own
        return jax.block_until_ready(_jitted(environment, policy, decisions, weights, replace(chunk, worlds=0), key))


def _check(decisions: int) -> None:
    if isinstance(decisions, bool) or not isinstance(decisions, int) or decisions < 1:
        raise ValueError(f"decisions: expected a whole number of at least 1, got {decisions!r}")


def _joined(batch: Batch, played: Sequence[tuple[_Now, Steps]]) -> tuple[Batch, Steps]:
    """Return the batch with its chunks as they are now, and the steps of all worlds."""
    pairs = zip(batch.chunks, played, strict=True)
    chunks = [replace(chunk, progress=progress, used=used) for chunk, ((progress, used), _) in pairs]
    return Batch(tuple(chunks)), joined([steps for _, steps in played], batch.sizes, 1)


def _play(
    environment: Environment, policy: ActingPolicy, decisions: int, weights: object, chunk: Chunk, key: jax.Array
) -> tuple[_Now, Steps]:
    """Play one chunk; arrays of the steps are (T, lanes, ...)."""
    keys = jax.random.split(key, chunk.game.shape[0])

    def decide(now: _Now, count: jax.Array) -> tuple[_Now, Steps]:
        own = jax.vmap(jax.random.fold_in, in_axes=(0, None))(keys, count)
        return _decide(environment, partial(policy, weights), chunk, now, own)

    return records.scan(decide, (chunk.progress, chunk.used), decisions)


_jitted = jax.jit(_play, static_argnums=(0, 1, 2))


def _decide(
    environment: Environment,
    policy: Callable[[jax.Array, jax.Array], tuple[jax.Array, Any]],
    chunk: Chunk,
    now: _Now,
    keys: jax.Array,
) -> tuple[_Now, Steps]:
    """Play one decision of one chunk; arrays of the step are (..., lanes)."""
    before, used = now
    step = before.state.step
    seen = environment.view(chunk.features, chunk.world, before)
    action, extras = jax.vmap(policy, in_axes=(0, -1), out_axes=-1)(keys, seen)
    action = environment.action_space().array(action, step.shape)
    blocks = standing(chunk.world, before, environment.strategy.slots)
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
