"""`make soak`: every public call with ever new scenes, for an hour; memory, programs, threads and files must not grow.

The mean resident memory of the last quarter of the samples may exceed that of the second by less than 1 %. After the
first quarter nothing is compiled any more, and there are no more threads or open files.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from record import record as record_check

import iphyre_jax
from iphyre_jax.adapters.gymnasium_env import GymnasiumEnv
from iphyre_jax.compat import IPHYRE
from iphyre_jax.execution.compilation import executables
from iphyre_jax.scenes import Scene, scene_to_dict
from iphyre_jax.train import trainer
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.viewer.plays import append_play, play_to_json, read_plays
from iphyre_jax.viewer.recording import record

GAMES = ("hole", "support")
SCENES = 8  # of each game and round
GROWTH = 0.01
ID = "on-the-fly/hole-v1"
CONFIG = TrainConfig(
    games=GAMES, hidden_sizes=(16,), updates=1_000_000, episodes_per_scene=8, variations=8, learner=PPO(minibatches=2)
)


def policy(key: jax.Array, obs: jax.Array) -> jax.Array:
    """Remove blocks at random, mostly none."""
    del obs
    return jnp.maximum(jax.random.randint(key, (), -60, 7), 0)


@dataclass
class Samples:
    """What the process holds, once an interval."""

    memory: list[float] = field(default_factory=list)  # MB
    compiled: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)
    files: list[int] = field(default_factory=list)

    def take(self, compiled: int) -> None:
        """Add a sample and print it."""
        self.memory.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6)
        self.compiled.append(compiled)
        self.threads.append(threading.active_count())
        self.files.append(len(list(Path("/proc/self/fd").iterdir())))
        told = f"{self.memory[-1]:.1f} MB, {compiled} programs compiled, {self.threads[-1]} threads"
        print(f"{told}, {self.files[-1]} files", flush=True)

    def problems(self) -> list[str]:
        """Return what has grown after the first quarter."""
        quarter = len(self.memory) // 4
        second, last = np.mean(self.memory[quarter : 2 * quarter]), np.mean(self.memory[-quarter:])
        growth = last / second - 1
        print(f"memory: {second:.1f} MB in the second quarter, {last:.1f} in the last, {100 * growth:+.2f} %")
        found = [] if growth < GROWTH else [f"memory has grown by {100 * growth:.2f} %"]
        for name in ("compiled", "threads", "files"):
            numbers = getattr(self, name)
            if max(numbers[quarter:]) > max(numbers[: quarter + 1]):
                found.append(f"{name}: {max(numbers[: quarter + 1])} have become {max(numbers[quarter:])}")
        return found


class Calls:
    """Every public call on the scenes of a round; folder: for files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.env, _ = iphyre_jax.make(ID)
        self.trainer = trainer.Trainer(CONFIG, trainer.start(CONFIG))
        self.reset = jax.jit(jax.vmap(self.env.reset, in_axes=(0, None)))
        self.step = jax.jit(jax.vmap(self.env.step, in_axes=(0, 0, 0, None)))

    def round(self, number: int) -> None:
        """Play new scenes in every way."""
        rng = np.random.default_rng(number)
        scenes = [new_scenes(game, number) for game in GAMES]
        mixed = [scene for of_game in scenes for scene in of_game]
        plans = rng.integers(-1, 150, (len(mixed), 1))
        iphyre_jax.simulate_many(mixed, range(len(mixed)), plans, fps=10)
        iphyre_jax.simulate_many(mixed, range(len(mixed)), plans, fps=10, share_prefixes=True)
        iphyre_jax.simulate(mixed[0], rng.integers(-1, 150, (200, 1)), fps=10, sample_every=50)
        iphyre_jax.play_plans(mixed, range(len(mixed)), rng.random((len(mixed), 6)))
        iphyre_jax.observation_table(mixed)
        scores = iphyre_jax.evaluate(policy, scenes[0], strategy="on-the-fly", episodes=4)
        assert np.isfinite(scores.reward).all()
        self.environments(scenes[0], number)
        self.files(mixed[0])
        self.officially(mixed[0])
        self.trainer.update_step()

    def environments(self, scenes: list[Scene], number: int) -> None:
        """Play the pure environment, batched and alone, and gymnasium's."""
        params, keys = self.env.params(scenes), jax.random.split(jax.random.key(number), 64)
        _, state = self.reset(keys, params)
        for _ in range(5):
            _, state, *_ = self.step(keys, state, jnp.zeros(64, jnp.int32), params)
        _, one = self.env.reset(keys[0], params)
        self.env.step(keys[0], one, 0, params)
        _, fresh = iphyre_jax.make(ID)
        self.env.reset(keys[0], fresh)
        own = GymnasiumEnv(ID)
        own.reset(seed=number)
        own.step(np.int64(0))
        own.close()

    def files(self, scene: Scene) -> None:
        """Write, read and replay."""
        path = self.folder / "scene.json"
        path.write_text(json.dumps(scene_to_dict(scene)))
        loaded = iphyre_jax.load_scene(path)
        plays = self.folder / "plays.jsonl"
        append_play(plays, play_to_json(record(loaded, [3], fps=10), "soak", {}))
        (play,) = read_plays(plays)
        assert not play.difference(play.record())
        plays.unlink()

    def officially(self, scene: Scene) -> None:
        """Play the official class."""
        game = IPHYRE(scene, fps=10)
        game.reset()
        game.step([0.0, 0.0])
        game.reset()
        game.simulate([[*scene.blocks[scene.eliminable_blocks[0]].mean(axis=0).tolist(), 1.0]])


def new_scenes(game: str, number: int) -> list[Scene]:
    """Return SCENES scenes that nobody has played, with the layout of a game."""
    found: list[Scene] = []
    for k in range(1000):
        found += iphyre_jax.vary(
            iphyre_jax.load_scene(game), SCENES, seed=1000 * number + k, shift_px=20.0, jitter_px=2.0
        ).scenes
        if len(found) >= SCENES:
            break
    return found[:SCENES]


def counted(compile_all: Callable[..., None], count: list[int]) -> Callable[..., None]:
    """Return `compile_all` with a count of its programs; JAX's own are counted by its events."""

    def event(name: str, _: float, **__: object) -> None:
        count[0] += name == "/jax/core/compile/backend_compile_duration"

    def counting(jobs: list[object], show: Callable[[int, int], None]) -> None:
        count[0] += len(jobs)
        compile_all(jobs, show)

    jax.monitoring.register_event_duration_secs_listener(event)
    return counting


def main() -> int:
    """Play, sample, judge; 0 if nothing has grown."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=60.0)
    minutes = parser.parse_args().minutes
    count = [0]
    executables.compile_all = counted(executables.compile_all, count)
    samples, began, rounds = Samples(), time.monotonic(), 0
    interval = min(60.0, 60 * minutes / 20)
    with tempfile.TemporaryDirectory() as folder:
        calls = Calls(Path(folder))
        calls.round(0)  # what it compiles is no matter of minutes
        started = time.monotonic()
        while time.monotonic() - started < 60 * minutes:
            rounds += 1
            calls.round(rounds)
            if time.monotonic() - started >= interval * (len(samples.memory) + 1):
                samples.take(count[0])
    problems = samples.problems()
    for problem in problems:
        print(problem)
    print(f"{rounds} rounds, {rounds * SCENES * len(GAMES)} new scenes")
    promise = f"ever new scenes for {minutes:g} minutes in every public call: memory grows by less than 1 %"
    record_check("soak", promise, rounds, rounds, len(problems), time.monotonic() - began)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
