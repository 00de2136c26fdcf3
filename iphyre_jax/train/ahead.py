"""Compile what an evaluation needs beside the training: `python -m iphyre_jax.train.ahead` in a process of its own.

Training seldom keeps all cores busy, and its games have fewer programs than the evaluation's. The process takes time
that nobody else wants, writes into the cache folder, says nothing, and ends with the process that began it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from iphyre_jax.envs.in_advance import play_plans
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.execution import configuration
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import on_cpu, partition_of
from iphyre_jax.execution.own_process import import_path
from iphyre_jax.execution.plan_batch import PlanBatch, Settings
from iphyre_jax.scenes import MAX_ELIMINABLE, load_scene
from iphyre_jax.train.settings.run import TrainConfig

MODULE: Final = "iphyre_jax.train.ahead"
PRIORITY: Final = 15  # added to the niceness; 19 would hardly run beside a busy machine


@contextmanager
def compiled_ahead(config: TrainConfig, games: Sequence[str]) -> Iterator[None]:
    """Compile the programs of a policy's evaluation in advance on some games, while the caller does other things.

    Does nothing where it cannot help: no games, all compiled already, one core, no cache folder, an accelerator, agents
    that decide on the fly (their programs are those of their training).
    """
    folder = configuration.cache_folder()
    helps = games and folder is not None and configuration.usable_cores() > 1 and on_cpu()
    if not helps or config.strategy != "in-advance" or _all_cached(config, games):
        yield
        return
    with _process(config, games, folder):
        yield


def _all_cached(config: TrainConfig, games: Sequence[str]) -> bool:
    protocol = EpisodeProtocol("ahead", config.fps, config.resets)
    scenes = [load_scene(game) for game in games]
    worlds = [cached_world(scene, config.resets, config.dtype) for scene in scenes]
    settings = Settings(float(config.fps), protocol.steps, config.dtype, config.resets, None)
    plan = np.full((len(games), MAX_ELIMINABLE), -1, np.int32)
    return PlanBatch(scenes, worlds, np.arange(len(games)), plan, settings, partition_of(None)).is_cached()


@contextmanager
def _process(config: TrainConfig, games: Sequence[str], folder: Path | None) -> Iterator[None]:
    options = ["--fps", str(config.fps), "--resets", str(config.resets), "--dtype", config.dtype]
    environment = {"PYTHONPATH": import_path(), "JAX_PLATFORMS": "cpu", "IPHYRE_JAX_CACHE": str(folder)}
    try:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            [sys.executable, "-P", "-m", MODULE, *options, *games],
            env={**os.environ, **environment},
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches only us, and we end it
        )
    except OSError:  # the evaluation compiles by itself, and says what is wrong
        yield
        return
    with process:
        try:
            yield
        finally:
            process.kill()


def _end_with_parent() -> None:
    """End when the input ends: whoever waits for the programs is gone. Processes that compile end likewise."""
    sys.stdin.read()
    os._exit(0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Play each game once, doing nothing, which compiles its program."""
    parser = argparse.ArgumentParser(description="Compile the programs of some games into the cache folder.")
    parser.add_argument("games", nargs="+")
    parser.add_argument("--fps", type=int, required=True)
    parser.add_argument("--resets", type=int, required=True)
    parser.add_argument("--dtype", required=True)
    asked = parser.parse_args(arguments)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(OSError, AttributeError):  # Windows has no such call
        os.nice(PRIORITY)
    nothing = np.zeros((1, MAX_ELIMINABLE))
    for game in asked.games:  # one after the other: the caller needs the other cores
        play_plans([game], [0], nothing, fps=asked.fps, resets=asked.resets, dtype=asked.dtype)


if __name__ == "__main__":
    main()
