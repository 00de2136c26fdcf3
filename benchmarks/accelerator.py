"""``python -m benchmarks.accelerator``: speed on a GPU, and agreement with the CPU of its machine, as Markdown tables.

Each row is printed as soon as it is measured, so a run that is killed has told what it found.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import getdoc
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray

import iphyre_jax
from benchmarks.learning.rows import rows as agent_rows
from benchmarks.worker_pool import ROOT
from benchmarks.workload import make_workload
from iphyre_jax.checks import check_option, check_whole
from iphyre_jax.envs.protocols import PROTOCOLS
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import on_cpu
from iphyre_jax.execution.plan_batch import contact_slots
from iphyre_jax.execution.programs import Score, pack_timing, world_layout
from iphyre_jax.provenance import CORE, made_by, provenance
from iphyre_jax.scenes.compile import step_timing
from iphyre_jax.scenes.scene import Scene
from iphyre_jax.train.trainer import Trainer, start
from parity.command import require_at_least

DECISIONS = 64  # of each world, in one scan
CHANCE = 0.1  # of a removal, at each decision
REPEATS = 5
DTYPES = ("float64", "float32")
FORMS = {"kernel": "one kernel", "operations": "a kernel for each fused operation"}

Part = Literal["steps", "decisions", "training", "agreement"]
Row = tuple[str, ...]


@dataclass(frozen=True)
class Options:
    """Measure steps, decisions and training on JAX's first device, and compare its plays with the CPU's.

    Attributes:
        parts: what to measure.
        games: games of the table of steps, each in a batch of its own.
        lanes: worlds of a batch.
        splits: games of the table of decisions: a game, "basic", "all" ...
        worlds: worlds of a loop of decisions.
        agents: rows of docs/results/results.md that are trained, seed 0.
        plans: plans of each of the forty games that are compared.
        fps: physics steps a second of steps, decisions and agreement; a decision lasts 0.1 s.
    """

    parts: tuple[Part, ...] = get_args(Part)
    games: tuple[str, ...] = ("hole", "fill", "multi_ball_lever")
    lanes: tuple[int, ...] = (1024, 16384, 131072)
    splits: tuple[str, ...] = ("hole", "basic", "all")
    worlds: tuple[int, ...] = (1024, 16384, 65536)
    agents: tuple[str, ...] = ("ppo-i", "ddpg-i", "sac-i", "ppo-o", "dqn-o", "sac-c")
    plans: int = 100
    fps: Literal[10, 60] = 10


def measured(
    function: Callable[..., jax.Array], given: Sequence[jax.Array], count: Callable[[jax.Array], int]
) -> tuple[float, float, float]:
    """Return seconds to compile, median seconds of a run, and steps or decisions a second.

    Args:
        function: what is compiled.
        given: its arguments.
        count: waits for its result, and returns how many steps or decisions were made.
    """
    start = time.perf_counter()
    program = jax.jit(function).lower(*given).compile()
    compiled, seconds = time.perf_counter() - start, []
    made = count(program(*given))
    for _ in range(REPEATS):
        start = time.perf_counter()
        count(program(*given))
        seconds.append(time.perf_counter() - start)
    return compiled, median(seconds), made / median(seconds)


def steps(options: Options) -> Iterator[Row]:
    """Random plans of one game, whole episodes, float32, until the scores are back on the host."""
    yield "game", "worlds", "form", "million steps a second", "s to compile"
    for game in options.games:
        for lanes in options.lanes:
            for form, name in FORMS.items():
                batch = batch_of(iphyre_jax.load_scene(game), lanes, options.fps, form)
                compiled, _, rate = measured(*batch, steps_made)
                yield game, f"{lanes:,}", name, f"{rate / 1e6:,.1f}", f"{compiled:.1f}"


def steps_made(counts: jax.Array) -> int:
    """Return the steps of counts, see `Score.in_lanes`."""
    return int(np.asarray(counts)[1].sum())


def batch_of(scene: Scene, lanes: int, fps: int, form: str) -> tuple[Callable[..., jax.Array], list[jax.Array]]:
    """Return a function that plays random plans and returns their counts, see `Score.in_lanes`, and its arguments."""
    topology, world = cached_world(scene, 1, "float32")
    workload = make_workload([scene], lanes, fps, seed=0)
    program = Score(replace(topology, slots=contact_slots(topology)[0]), "float32", lanes, workload.plans.shape[1])
    table = world_layout(topology, "float32").pack_many([world])
    worlds, plans = np.repeat(table, lanes, 1), np.ascontiguousarray(workload.plans.T)
    timing, most = pack_timing(step_timing(fps, "float32")), np.array([workload.steps], np.int32)

    def play(worlds: jax.Array, plans: jax.Array, timing: jax.Array, most: jax.Array) -> jax.Array:
        if form == "kernel":
            return program.run(worlds, plans, timing, most)[0]
        return program.in_lanes((timing, most), (worlds, plans))

    return play, [jax.device_put(array) for array in (worlds, plans, timing, most)]


def decisions(options: Options) -> Iterator[Row]:
    """A user's own loop: a scan of `env.step` under `vmap`, with random actions, observations and autoreset."""
    yield "games", "worlds", "ms a decision", "million decisions a second", "s to compile"
    for split in options.splits:
        for worlds in options.worlds:
            loop = loop_of(split, worlds, options.fps)
            compiled, seconds, rate = measured(loop, [jax.random.key(0)], partial(finished, DECISIONS * worlds))
            yield split, f"{worlds:,}", f"{1e3 * seconds / DECISIONS:.3f}", f"{rate / 1e6:,.2f}", f"{compiled:.1f}"


def finished(made: int, result: jax.Array) -> int:
    """Wait for a result, and return how many decisions were made."""
    result.block_until_ready()
    return made


def loop_of(split: str, worlds: int, fps: int) -> Callable[[jax.Array], jax.Array]:
    """Return a loop of DECISIONS decisions as a function of a key; its result depends on all of them."""
    protocol = next(one.name for one in PROTOCOLS.values() if one.fps == fps)
    env, params = iphyre_jax.make(f"on-the-fly/{split}-v1", protocol=protocol, backend="xla")

    def one(carry: Any, key: jax.Array) -> Any:  # noqa: ANN401 - trees of arrays
        state, seen = carry
        for_chance, for_action, for_step = jax.random.split(key, 3)
        chosen = jax.random.randint(for_action, (worlds,), 0, env.num_actions)
        action = jnp.where(jax.random.bernoulli(for_chance, CHANCE, (worlds,)), chosen, 0)
        keys = jax.random.split(for_step, worlds)
        obs, state, reward, *_ = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, state, action, params)
        return (state, seen + obs.sum() + reward.sum()), None

    def loop(key: jax.Array) -> jax.Array:
        for_reset, for_steps = jax.random.split(key)
        _, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(for_reset, worlds), params)
        return jax.lax.scan(one, (state, jnp.float32(0)), jax.random.split(for_steps, DECISIONS))[0][1]

    return loop


def training(options: Options) -> Iterator[Row]:
    """Default agents, with the time until they have made their first update, which compiles, and of the other updates.

    Ten steps a second, one process. Rewards are those of greedy actions in the training games after the last update.
    """
    yield "agent", "s to the first update", "updates", "ms for each other update", "s in all", "mean reward"
    for name in options.agents:
        config = agent_rows()[name]
        begun = time.perf_counter()
        trainer = Trainer(config, start(config))
        trainer.update_step()
        first = time.perf_counter() - begun
        for _ in range(1, config.updates):
            trainer.update_step()
        whole = time.perf_counter() - begun
        each = (whole - first) / max(config.updates - 1, 1)
        numbers = f"{1e3 * each:.1f}", f"{whole:.1f}", f"{trainer.greedy_reward():.1f}"
        yield name, f"{first:.1f}", f"{config.updates}", *numbers


def agreement(options: Options) -> Iterator[Row]:
    """Random plans of all forty games, beside the same plays on the CPU, which in float64 are pymunk's.

    An outcome is success, steps, removals and fault. Distances are between last positions.
    """
    yield "type", "games", "same outcome", "all bits of poses", "median, px", "largest, px"
    scenes = [iphyre_jax.load_scene(game) for game in iphyre_jax.GAMES]
    still = np.array([not scene.dynamic[: scene.n_blocks].any() for scene in scenes])
    for dtype in DTYPES:
        (outcomes, one), (expected, other) = (played(platform, dtype, options) for platform in ("cpu", ""))
        same = (outcomes == expected).all(-1)
        word = f"int{8 * one.itemsize}"
        bits = (one.view(word) == other.view(word)).all((1, 2))
        apart = np.nanmax(np.abs(one - other)[..., :2], axis=(1, 2))
        of_still = still[np.arange(len(same)) % len(still)]
        sets = {"all forty": np.ones_like(of_still), "balls alone move": of_still, "bars move": ~of_still}
        for name, chosen in sets.items():
            shares = [f"{int(found[chosen].sum()):,} of {int(chosen.sum()):,}" for found in (same, bits)]
            yield dtype, name, *shares, f"{np.median(apart[chosen]):.1e}", f"{apart[chosen].max():.1e}"


def played(platform: str, dtype: str, options: Options) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return outcomes and last poses of plays on a platform of JAX, "" for its default, in a process of its own."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "JAX_PLATFORMS": platform}
    env["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # this process has most of the device's memory
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plays.npz"
        numbers = str(options.fps), str(options.plans)
        command = [sys.executable, "-m", "benchmarks.workers.final_poses", *numbers, dtype, str(file)]
        subprocess.run(command, env=env, check=True)  # noqa: S603 - our own arguments
        with np.load(file) as found:
            return found["outcomes"], found["poses"]


TABLES: dict[Part, Callable[[Options], Iterator[Row]]] = {
    "steps": steps,
    "decisions": decisions,
    "training": training,
    "agreement": agreement,
}


def show(row: Sequence[str]) -> None:
    """Print a row of a Markdown table."""
    print("| " + " | ".join(row) + " |", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0, or 2 for bad options or without a GPU."""
    options = tyro.cli(Options, args=arguments, prog="python -m benchmarks.accelerator")
    try:
        require_at_least(options, plans=1)
        for name in options.agents:
            check_option("agents", name, tuple(agent_rows()))
        for game in options.games:
            iphyre_jax.load_scene(game)
        for split in options.splits:
            check_option("splits", f"on-the-fly/{split}-v1", iphyre_jax.environment_ids())
        for name in ("lanes", "worlds"):
            for number in getattr(options, name):
                check_whole(name, number)
        if on_cpu():
            raise ValueError("expected a GPU: JAX's first device is a CPU")
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    warnings.simplefilter("error", RuntimeWarning)  # a program without its kernel must not pass for one with it
    for part in options.parts:
        print(f"\n## {part.capitalize()}\n\n{getdoc(TABLES[part])}\n")
        rows = TABLES[part](options)
        names = next(rows)
        for row in chain([names, ["---"] * len(names)], rows):
            show(row)
    print(f"\n{made_by({**provenance(CORE), 'fps': options.fps})}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
