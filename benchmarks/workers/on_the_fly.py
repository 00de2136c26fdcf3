"""Decisions on the fly beside plain simulation: ``python -m benchmarks.workers.on_the_fly FPS WORLDS REPEATS GAME...``.

A random policy plays whole episodes in every world. `simulate_many` then plays the plans that result from its actions,
so both make the same physics steps. The policy reads each observation as a weighted sum; otherwise the compiler could
leave the observations out. A second policy also returns them. The other variants are a user's own loop: a `lax.scan`
over `jax.vmap(env.step)` with autoreset and with given actions and keys, which reads observations in the same way: by
the host, with `backend="xla"` on one device, and so on several, as many as there are cores if they divide the worlds.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import iphyre_jax
from iphyre_jax.envs import Batch, Environment, EnvParams, EnvState, Steps, unroll
from iphyre_jax.envs.core import BackendName
from iphyre_jax.envs.protocols import PROTOCOLS
from iphyre_jax.execution.configuration import usable_cores

CHANCE = 0.06  # of a click at a slot, at each decision


def reads(weights: jax.Array, key: jax.Array, obs: jax.Array) -> tuple[jax.Array, Any]:
    """Click at random; the observation is read but never changes the action."""
    drawn = jax.random.uniform(key)
    slot = (drawn * (6 / CHANCE)).astype(jnp.int32) + 1
    return jnp.where((drawn < CHANCE) & (obs @ weights < jnp.inf), slot, 0), ()


def keeps(weights: jax.Array, key: jax.Array, obs: jax.Array) -> tuple[jax.Array, Any]:
    """Do the same and return the observation too."""
    return reads(weights, key, obs)[0], obs


def plans(environment: Environment, games: np.ndarray[Any, Any], steps: Steps) -> np.ndarray[Any, Any]:
    """The plans of the actions of whole episodes: (B, 6) step before which each block is removed, -1 for never."""
    action = np.asarray(steps.action)
    blocks = [len(iphyre_jax.load_scene(game).eliminable_blocks) for game in environment.games]
    clicked = action[:, :, None] == np.arange(1, 7)
    first = np.where(clicked.any(axis=0), clicked.argmax(axis=0) * environment.protocol.steps_per_frame, -1)
    return np.where(np.arange(6) < np.array(blocks)[games][:, None], first, -1)


@partial(jax.jit, static_argnums=0)
def scan(
    environment: Environment,
    weights: jax.Array,
    params: EnvParams,
    state: EnvState,
    keys: jax.Array,
    actions: jax.Array,
) -> tuple[EnvState, tuple[jax.Array, ...]]:
    """Step all worlds with actions (T, B); return the last state, and time, end and what is read of it, (T, B)."""

    def step(state: EnvState, given: tuple[jax.Array, jax.Array]) -> tuple[EnvState, tuple[jax.Array, ...]]:
        out = jax.vmap(environment.step, in_axes=(0, 0, 0, None))(given[0], state, given[1], params)
        return out[1], (out[5]["time"], out[3] | out[4], out[0] @ weights)

    return jax.lax.scan(step, state, (keys, actions))


def timed(variant: Callable[[], object]) -> tuple[float, float]:
    """Return wall-clock and processor seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    jax.block_until_ready(variant())
    return time.perf_counter() - wall, time.process_time() - cpu


def main(fps: int, worlds: int, repeats: int, games: list[str]) -> None:
    """Measure all variants in turns and print one line of JSON."""
    iphyre_jax.configure(devices=math.gcd(worlds, usable_cores()))
    jax.config.update("jax_enable_compilation_cache", False)  # the time that the user's program takes is measured
    protocol = next(protocol for protocol in PROTOCOLS.values() if protocol.fps == fps)
    iphyre_jax.register("measured-v1", games)
    env, params = iphyre_jax.make("on-the-fly/measured-v1", protocol=protocol.name, autoreset=False)
    batch = Batch.of(env, params, np.arange(worlds) % len(games))
    weights, key, order = jnp.ones(env.observation_space().shape), jax.random.key(0), np.asarray(batch.game)
    play = partial(unroll, decisions=env.strategy.decisions)
    _, steps = play(env, reads, weights, batch, key)
    plan, end_step = plans(env, order, steps), np.rint(np.asarray(steps.info["time"])[-1] * fps).astype(int)
    simulate = partial(iphyre_jax.simulate_many, env.games, order, plan, fps=fps, resets=protocol.resets)
    loops, compiled = user_loops(protocol.name, batch, weights, jax.random.key(1), steps.action)
    variants: dict[str, Callable[[], object]] = {
        "simulate": simulate,
        **loops,
        "reads": lambda: play(env, reads, weights, batch, key),
        "keeps": lambda: play(env, keeps, weights, batch, key),
    }
    same = float((simulate().steps == end_step).mean())
    variants["keeps"]()
    count = dict.fromkeys(variants, int(end_step.sum()))
    for name, loop in loops.items():
        clock, ended, _ = map(np.asarray, loop()[1])
        since = np.where(ended[:-1], 0, clock[:-1])
        count[name] = int(np.rint((clock.sum() - since.sum()) * fps))
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in variants}
    for _ in range(repeats):
        for name, variant in variants.items():
            seconds[name].append(timed(variant))
    found = {"steps": count, "same_steps": same, "seconds": seconds, "compiled": compiled}
    print(json.dumps(found), flush=True)


def user_loops(
    protocol: str, batch: Batch, weights: jax.Array, key: jax.Array, actions: jax.Array
) -> tuple[dict[str, Callable[[], Any]], dict[str, float]]:
    """A user's loop by backend, and the seconds that its program takes to compile, our own programs apart."""
    loops: dict[str, Callable[[], Any]] = {}
    compiled = {}
    keys = jax.random.split(key, actions.shape)
    mesh = jax.make_mesh((jax.device_count(),), ("worlds",), axis_types=(AxisType.Auto,))
    rows, columns, whole = (NamedSharding(mesh, PartitionSpec(*axes)) for axes in (["worlds"], [None, "worlds"], []))
    for name in ("scan", "xla", "spread"):
        backend: BackendName = "host" if name == "scan" else "xla"
        env, params = iphyre_jax.make("on-the-fly/measured-v1", protocol=protocol, backend=backend)
        state = Batch.of(env, params, np.asarray(batch.game)).state
        given = weights, params, state, keys, actions
        if name == "spread":
            given = tuple(map(jax.device_put, given, (whole, whole, rows, columns, columns)))
        jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None))).lower(keys[0], state, actions[0], params)
        jax.clear_caches()  # our programs stay, and nothing else
        begin = time.perf_counter()
        program = scan.lower(env, *given).compile()
        compiled[name] = time.perf_counter() - begin
        loops[name] = partial(program, *given)
    return loops, compiled


if __name__ == "__main__":
    if len(sys.argv) < 5:
        sys.exit("expected FPS WORLDS REPEATS GAME ..., such as 10 1024 7 hole")
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
