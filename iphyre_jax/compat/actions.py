"""`generate_actions` of the official package: random plans, until enough solve a game and enough do not."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from itertools import count, islice

import numpy as np

from iphyre_jax.compat.games import scene_of
from iphyre_jax.execution.compilation.executables import executable
from iphyre_jax.execution.programs import Score, pack_timing, world_layout
from iphyre_jax.plans import official_clock, plan_to_steps
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import compile_scene, step_timing

FPS = 60
DTYPE = "float64"
BATCH = 64  # plans played side by side; those beyond the last one needed are dropped

Action = list[float]  # seconds of each slot, then solved (1 or 0), blocks removed, seconds played


def generate_actions(
    game: str | os.PathLike[str] | Scene,
    num_succeed: int,
    num_fail: int,
    interval: float,
    max_game_time: float,
    max_action_time: float,
    max_step: int,
    seed: int = 0,
    epsilon: float = 0.2,
) -> tuple[list[Action], list[Action], int]:
    """Draw random plans at 60 steps a second until there are enough of both kinds.

    The official function draws the same plans with the same seed and resets one space in the same way. Its check for
    repeated plans works only in games with `max_step` blocks, here too. The global random states stay as they are.

    Args:
        game: a game's name, a scene file or a Scene.
        num_succeed: plans wanted that solve the game.
        num_fail: plans wanted that do not.
        interval: s, times are multiples of it.
        max_game_time: s, at least max_action_time; it has no other effect, as in the official function.
        max_action_time: s, times are below it.
        max_step: slots of a plan, at least the number of the game's blocks.
        seed: of the draws.
        epsilon: probability that a time becomes 0, which leaves the block.

    Returns:
        The plans that solve the game, those that do not, and the number of drawn plans. A plan is its times, 0 after
        the end of the episode, then solved, blocks removed and seconds played.

    Raises:
        ValueError: one line naming the argument and what was expected.
        RuntimeError: a world has a fault; one line.
    """
    scene = scene_of(game)
    instants = _instants(scene, interval, max_game_time, max_action_time, max_step)
    plans = _draw(instants, len(scene.eliminable_blocks), max_step, seed, epsilon)
    succeeded: list[Action] = []
    failed: list[Action] = []
    drawn = 0
    for plan, (solved, removed, seconds) in _score_in_batches(scene, plans):
        if len(succeeded) >= num_succeed and len(failed) >= num_fail:
            break
        drawn += 1
        done = [float(t * (t <= seconds)) for t in plan]
        chosen, wanted = (succeeded, num_succeed) if solved else (failed, num_fail)
        if len(chosen) < wanted:
            chosen.append([*done, solved, removed, seconds])
    return succeeded, failed, drawn


def _instants(
    scene: Scene, interval: float, max_game_time: float, max_action_time: float, max_step: int
) -> list[float]:
    """Return the times to draw from, s."""
    blocks = len(scene.eliminable_blocks)
    if not 0 < max_action_time <= max_game_time:
        raise ValueError(f"max_action_time: expected seconds from 0 to {max_game_time}, got {max_action_time!r}")
    if max_step < blocks:
        raise ValueError(f"max_step: expected at least the {blocks} blocks of {scene.name}, got {max_step!r}")
    instants = list(np.arange(0, max_action_time, interval))
    if len(instants) < blocks:
        raise ValueError(f"interval: expected at least {blocks} instants below {max_action_time} s, got {interval!r}")
    return instants


def _score_in_batches(scene: Scene, plans: Iterator[Action]) -> Iterator[tuple[Action, tuple[int, int, float]]]:
    """Play plans batch by batch; yield each with solved, blocks removed and seconds."""
    for first in count(2, BATCH):  # the official function resets once before the first plan
        batch = list(islice(plans, BATCH))
        yield from zip(batch, _score_plans(scene, batch, first), strict=True)


def _draw(instants: list[float], blocks: int, slots: int, seed: int, epsilon: float) -> Iterator[Action]:
    """Draw plans without end, with the random numbers in the official order."""
    generator, noise = random.Random(seed), np.random.RandomState(seed)  # noqa: S311  # the official streams
    drawn: list[Action] = []
    while True:
        times = generator.sample(instants, blocks)
        while times in drawn:
            times = generator.sample(instants, blocks)
        times = [t * (noise.uniform() > epsilon) for t in times]
        times += [0.0] * (slots - blocks)
        drawn.append(times)
        yield times


def _score_plans(scene: Scene, plans: list[Action], resets: int) -> list[tuple[int, int, float]]:
    """Play plans in successive resets of one space; return solved, blocks removed and seconds of each."""
    compiled = [compile_scene(scene, resets=resets + k, dtype=DTYPE) for k in range(len(plans))]
    steps = plan_to_steps(np.array(plans), FPS, "simulate").astype(np.int32)
    program = Score(compiled[0][0], DTYPE, BATCH, steps.shape[1])
    worlds = world_layout(program.topology, DTYPE).pack_many([world for _, world in compiled])
    frames = np.array([len(official_clock(FPS)), 1], np.int32)
    counts = executable(program)(worlds, np.ascontiguousarray(steps.T), pack_timing(step_timing(FPS, DTYPE)), frames)[0]
    solved, removed, fault = counts[0], counts[2], counts[3]
    if fault.any():
        raise RuntimeError(f"{scene.name}: the world is no longer sound (fault {fault.max()})")
    instants = official_clock(FPS)
    seconds = np.append(instants, instants[-1] + 1 / FPS)[counts[1]]
    return [(int(good), int(gone), float(end)) for good, gone, end in zip(solved, removed, seconds, strict=True)]
