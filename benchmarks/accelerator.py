"""``python -m benchmarks.accelerator``: speed on a GPU, and agreement with the CPU of its machine, as a page."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray

import iphyre_jax
from benchmarks.worker_pool import ROOT
from benchmarks.workload import make_workload
from iphyre_jax.envs.protocols import PROTOCOLS
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import on_cpu
from iphyre_jax.execution.plan_batch import contact_slots
from iphyre_jax.execution.programs import Score, pack_timing, world_layout
from iphyre_jax.files import replace_text
from iphyre_jax.provenance import CORE, made_by, provenance
from iphyre_jax.scenes.compile import step_timing
from iphyre_jax.scenes.scene import Scene

DECISIONS = 64  # of each world, in one scan
CHANCE = 0.1  # of a removal, at each decision
REPEATS = 5
DTYPES = ("float64", "float32")
FORMS = {"kernel": "one kernel", "operations": "a kernel for each fused operation"}


@dataclass(frozen=True)
class Options:
    """Measure physics steps and decisions a second on JAX's first device, and compare its plays with the CPU's.

    Attributes:
        games: games of the table of steps, each in a batch of its own.
        lanes: worlds of a batch.
        split: games of the table of decisions: a game, "basic", "all" ...
        worlds: worlds of a loop of decisions.
        plans: plans of each of the forty games that are compared; 0 for none.
        fps: physics steps a second; a decision lasts 0.1 s.
        page: Markdown to write.
    """

    games: tuple[str, ...] = ("hole", "fill", "multi_ball_lever")
    lanes: tuple[int, ...] = (1024, 16384, 131072)
    split: tuple[str, ...] = ("hole", "basic", "all")
    worlds: tuple[int, ...] = (1024, 16384)
    plans: int = 100
    fps: int = 10
    page: Path = Path("docs") / "results" / "gpu.md"


@dataclass
class Measured:
    """What was measured of one program; run: plays it, and returns how many steps or decisions it made."""

    what: tuple[str, ...]
    compile_s: float
    run: Callable[[], int]
    seconds: list[float] = field(default_factory=list)
    made: int = 0

    def measure(self) -> None:
        """Run once without a clock, then REPEATS times."""
        self.made = self.run()
        for _ in range(REPEATS):
            start = time.perf_counter()
            self.run()
            self.seconds.append(time.perf_counter() - start)

    @property
    def rate(self) -> float:
        """Steps or decisions a second."""
        return self.made / median(self.seconds)


def steps_of(scene: Scene, lanes: int, fps: int, form: str) -> Measured:
    """Compile a batch of random plans of one game, float32, whole episodes."""
    topology, world = cached_world(scene, 1, "float32")
    workload = make_workload([scene], lanes, fps, seed=0)
    program = Score(replace(topology, slots=contact_slots(topology)[0]), "float32", lanes, workload.plans.shape[1])
    table = world_layout(topology, "float32").pack_many([world])
    worlds, plans = np.repeat(table, lanes, 1), np.ascontiguousarray(workload.plans.T)
    timing, steps = pack_timing(step_timing(fps, "float32")), np.array([workload.steps], np.int32)
    given = [jax.device_put(array) for array in (worlds, plans, timing, steps)]

    def operations(worlds: jax.Array, plans: jax.Array, timing: jax.Array, steps: jax.Array) -> tuple[jax.Array]:
        return (program.in_lanes((timing, steps), (worlds, plans)),)

    start = time.perf_counter()
    compiled = jax.jit(program.run if form == "kernel" else operations).lower(*given).compile()
    took = time.perf_counter() - start
    return Measured((scene.name, f"{lanes:,}", form), took, lambda: int(np.asarray(compiled(*given)[0])[1].sum()))


def decisions_of(split: str, worlds: int, fps: int) -> Measured:
    """Compile a user's loop: a scan of `env.step` under `vmap`, with random actions, observations and autoreset."""
    protocol = next(one.name for one in PROTOCOLS.values() if one.fps == fps)
    env, params = iphyre_jax.make(f"on-the-fly/{split}-v1", protocol=protocol, backend="xla")

    def one(carry: Any, key: jax.Array) -> Any:  # noqa: ANN401 - trees of arrays
        state, seen = carry
        for_action, for_step = jax.random.split(key)
        chosen = jax.random.randint(for_action, (worlds, 2), 0, jnp.array([env.num_actions, round(1 / CHANCE)]))
        keys = jax.random.split(for_step, worlds)
        action = jnp.where(chosen[:, 1] == 0, chosen[:, 0], 0)
        obs, state, reward, *_ = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, state, action, params)
        return (state, seen + obs.sum() + reward.sum()), None

    def loop(key: jax.Array) -> jax.Array:
        for_reset, for_steps = jax.random.split(key)
        _, state = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(for_reset, worlds), params)
        return jax.lax.scan(one, (state, jnp.float32(0)), jax.random.split(for_steps, DECISIONS))[0][1]

    key = jax.random.key(0)
    start = time.perf_counter()
    compiled = jax.jit(loop).lower(key).compile()
    took = time.perf_counter() - start

    def run() -> int:
        compiled(key).block_until_ready()
        return DECISIONS * worlds

    return Measured((split, f"{worlds:,}"), took, run)


@dataclass(frozen=True)
class Plays:
    """Plays of a process of their own, under way."""

    process: subprocess.Popen[bytes]
    file: Path

    @classmethod
    def begin(cls, options: Options, folder: Path, dtype: str, platform: str) -> Plays:
        """Begin to play on a platform of JAX, "" for its default."""
        file = folder / f"{platform} {dtype}.npz"
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "JAX_PLATFORMS": platform}
        env["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # this process has most of the device's memory
        numbers = str(options.fps), str(options.plans)
        command = [sys.executable, "-m", "benchmarks.workers.final_poses", *numbers, dtype, str(file)]
        return cls(subprocess.Popen(command, env=env), file)  # noqa: S603 - our own arguments

    def end(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Wait, and return outcomes and last poses.

        Raises:
            RuntimeError: the process failed.
        """
        if code := self.process.wait():
            raise RuntimeError(f"the process that wrote {self.file.name} ended with {code}")
        with np.load(self.file) as found:
            return found["outcomes"], found["poses"]


def agreement(dtype: str, own: Plays, cpu: Plays) -> Iterator[tuple[str, ...]]:
    """Yield a row of all games, of those in which balls alone move, and of the others."""
    scenes = [iphyre_jax.load_scene(game) for game in iphyre_jax.GAMES]
    still = np.array([not scene.dynamic[: scene.n_blocks].any() for scene in scenes])
    (outcomes, one), (expected, other) = own.end(), cpu.end()
    same = (outcomes == expected).all(-1)
    bits = ((one == other) | (np.isnan(one) & np.isnan(other))).all((1, 2))
    apart = np.nanmax(np.abs(one - other)[..., :2], axis=(1, 2))
    of_still = still[np.arange(len(same)) % len(still)]
    sets = {"all forty": np.ones_like(of_still), "balls alone move": of_still, "bars move": ~of_still}
    for name, chosen in sets.items():
        shares = [f"{int(found[chosen].sum()):,} of {int(chosen.sum()):,}" for found in (same, bits)]
        yield dtype, name, *shares, f"{np.median(apart[chosen]):.1e}", f"{apart[chosen].max():.1e}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))


def page(
    options: Options, steps: Sequence[Measured], decisions: Sequence[Measured], agreed: Sequence[Sequence[str]]
) -> str:
    """Return the page."""
    of_steps = [(*one.what[:2], FORMS[one.what[2]], f"{one.rate / 1e6:,.1f}", f"{one.compile_s:.1f}") for one in steps]
    of_decisions = [
        (*one.what, f"{1e3 * median(one.seconds) / DECISIONS:.3f}", f"{one.rate / 1e6:,.2f}", f"{one.compile_s:.1f}")
        for one in decisions
    ]
    parts = [
        "# GPU",
        f"Written by `python -m benchmarks.accelerator`. Figures are medians of {REPEATS} runs at {options.fps} steps "
        "a second. Programs were compiled side by side, so each took longer than alone. How the kernel came about: "
        "[decisions](../decisions/engine.md).",
        "## Steps",
        "Random plans of one game, whole episodes, float32, and the scores back on the host.",
        table(("game", "worlds", "form", "million steps a second", "s to compile"), of_steps),
        "## Decisions",
        "A user's own loop: `env.step` under `vmap` in a `scan`, with random actions, observations and autoreset. "
        "A decision lasts 0.1 s of the game.",
        table(("games", "worlds", "ms a decision", "million decisions a second", "s to compile"), of_decisions),
    ]
    if agreed:
        parts += [
            "## Agreement with the CPU",
            f"{options.plans} random plans of each of the forty games, beside the same plays on the CPU, which in "
            "float64 are pymunk's. An outcome is success, steps, removals and fault. Distances are between last "
            "positions.",
            table(("type", "games", "same outcome", "all bits of poses", "median, px", "largest, px"), agreed),
        ]
    facts = {**provenance(CORE), "games": " ".join(options.games)}
    return "\n\n".join((*parts, made_by(facts))) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Measure and write the page; return 0, or 2 without a GPU."""
    options = tyro.cli(Options, args=arguments, prog="python -m benchmarks.accelerator")
    if on_cpu():
        print("expected a GPU: JAX's first device is a CPU", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        begin = partial(Plays.begin, options, Path(folder))
        playing = [(dtype, begin(dtype, ""), begin(dtype, "cpu")) for dtype in DTYPES if options.plans]
        programs = [
            pool.submit(steps_of, iphyre_jax.load_scene(game), lanes, options.fps, form)
            for game in options.games
            for lanes in options.lanes
            for form in FORMS
        ]
        loops = [
            pool.submit(decisions_of, split, worlds, options.fps)
            for split in options.split
            for worlds in options.worlds
        ]
        steps, decisions = ([one.result() for one in part] for part in (programs, loops))
        agreed = [row for plays in playing for row in agreement(*plays)]
        options.page.parent.mkdir(parents=True, exist_ok=True)
        for one in (*steps, *decisions):
            one.measure()
            print(*one.what, f"{one.rate / 1e6:,.2f} million a second, compiled in {one.compile_s:.1f} s", flush=True)
            first, second = ([each for each in part if each.seconds] for part in (steps, decisions))
            replace_text(options.page, page(options, first, second, agreed))
    print(f"saved {options.page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
