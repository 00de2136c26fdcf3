"""Decisions on the fly beside plain simulation: ``python -m benchmarks.workers.on_the_fly FPS WORLDS TURNS GAME...``.

A random policy plays whole episodes in every world; the plans that come of its actions are then played by
`simulate_many`, so both make the same physics steps. The policy adds up all numbers of each observation with weights,
for a policy that looked at nothing would let the compiler leave the observations out. A second one also keeps them.
Beside them the loop of a user: a `lax.scan` over `jax.vmap(env.step)` with autoreset, actions and keys given.
"""

import json
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import iphyre_jax
from iphyre_jax.envs import Batch, Environment, EnvParams, EnvState, Steps, unroll
from iphyre_jax.envs.protocols import PROTOCOLS

CHANCE = 0.06  # of a click at a slot, at each decision


def reads(weights: jax.Array, key: jax.Array, seen: jax.Array) -> tuple[jax.Array, Any]:
    """Click at random; what is seen counts, though it never changes anything."""
    drawn = jax.random.uniform(key)
    slot = (drawn * (6 / CHANCE)).astype(jnp.int32) + 1
    return jnp.where((drawn < CHANCE) & (seen @ weights < jnp.inf), slot, 0), ()


def keeps(weights: jax.Array, key: jax.Array, seen: jax.Array) -> tuple[jax.Array, Any]:
    """Do the same and keep the observation."""
    return reads(weights, key, seen)[0], seen


def plans(environment: Environment, games: np.ndarray[Any, Any], steps: Steps) -> np.ndarray[Any, Any]:
    """Return the step before which each block goes, (B, 6), -1 for never, of the actions of whole episodes."""
    action = np.asarray(steps.action)
    blocks = [len(iphyre_jax.load_scene(game).eliminable_blocks) for game in environment.games]
    clicked = action[:, :, None] == np.arange(1, 7)
    first = np.where(clicked.any(axis=0), clicked.argmax(axis=0) * environment.protocol.steps_per_frame, -1)
    return np.where(np.arange(6) < np.array(blocks)[games][:, None], first, -1)


@partial(jax.jit, static_argnums=0)
def scan(
    environment: Environment, params: EnvParams, state: EnvState, keys: jax.Array, actions: jax.Array
) -> tuple[EnvState, tuple[jax.Array, ...]]:
    """Step all worlds with actions (T, B): the last state; time, end and the sum of the observation, (T, B) each."""

    def turn(state: EnvState, given: tuple[jax.Array, jax.Array]) -> tuple[EnvState, tuple[jax.Array, ...]]:
        out = jax.vmap(environment.step, in_axes=(0, 0, 0, None))(given[0], state, given[1], params)
        return out[1], (out[5]["time"], out[3] | out[4], out[0].sum(axis=1))

    return jax.lax.scan(turn, state, (keys, actions))


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Return wall-clock and processor seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    jax.block_until_ready(work())
    return time.perf_counter() - wall, time.process_time() - cpu


def main(fps: int, worlds: int, turns: int, games: list[str]) -> None:
    """Measure all in turns and tell it as one line of JSON."""
    protocol = next(protocol for protocol in PROTOCOLS.values() if protocol.fps == fps)
    iphyre_jax.register("measured-v1", games)
    env, params = iphyre_jax.make("on-the-fly/measured-v1", protocol=protocol.name, autoreset=False)
    batch = Batch.of(env, params, np.arange(worlds) % len(games))
    weights, key, order = jnp.ones(env.observation_space().shape), jax.random.key(0), np.asarray(batch.game)
    play = partial(unroll, decisions=env.strategy.decisions)
    _, steps = play(env, reads, weights, batch, key)
    plan, made = plans(env, order, steps), np.rint(np.asarray(steps.info["time"])[-1] * fps).astype(int)
    simulate = partial(iphyre_jax.simulate_many, env.games, order, plan, fps=fps, resets=protocol.resets)
    again, _ = iphyre_jax.make("on-the-fly/measured-v1", protocol=protocol.name)
    keys = jax.random.split(key, (env.strategy.decisions, worlds))
    begin = time.perf_counter()
    scan.lower(again, params, batch.state, keys, steps.action).compile()
    compiled = time.perf_counter() - begin
    works: dict[str, Callable[[], object]] = {
        "simulate": simulate,
        "scan": lambda: scan(again, params, batch.state, keys, steps.action),
        "reads": lambda: play(env, reads, weights, batch, key),
        "keeps": lambda: play(env, keeps, weights, batch, key),
    }
    same = float((simulate().steps == made).mean())
    until, ended, _ = map(np.asarray, scan(again, params, batch.state, keys, steps.action)[1])
    works["keeps"]()
    since = np.where(ended[:-1], 0, until[:-1])
    count = dict.fromkeys(works, int(made.sum()))
    count["scan"] = int(np.rint((until.sum() - since.sum()) * fps))
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(turns):
        for name, work in works.items():
            seconds[name].append(timed(work))
    told = {"steps": count, "same_steps": same, "seconds": seconds, "compiled": compiled}
    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
