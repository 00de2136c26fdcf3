"""`generate_actions` of the official package: random plans, until enough solve a game and enough do not."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from itertools import count, islice

import numpy as np

from iphyre_jax.checks import check_least, check_positive, check_whole
from iphyre_jax.compat.games import scene_of
from iphyre_jax.execution.compilation.executables import executable
from iphyre_jax.execution.programs import Score, pack_timing, world_layout
from iphyre_jax.plans import official_clock, plan_to_steps
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import compile_scene, step_timing
from iphyre_jax.scenes.limits import MOST_OBJECTS

DTYPE = "float64"
BATCH = 64  # plans played side by side; those beyond the last one needed are dropped

MOST_PLANS = 1_000_000  # of a kind
MOST_INSTANTS = 1_000_000
MOST_SECONDS = 1000.0
REPEATS = 100_000  # draws in a row of plans that were drawn before: there is hardly another

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
        num_succeed: plans wanted that solve the game, 0 to 1,000,000.
        num_fail: plans wanted that do not, 0 to 1,000,000. As in the official function the search goes on for ever if
            hardly any plan is of a kind that is wanted.
        interval: s, times are multiples of it; at least a millionth of max_action_time.
        max_game_time: s, at least max_action_time; it has no other effect, as in the official function.
        max_action_time: s, times are below it; at most 1,000.
        max_step: slots of a plan, at least the number of the game's blocks, at most 64.
        seed: of the draws, 0 to 2**32 - 1.
        epsilon: probability that a time becomes 0, which leaves the block; 0 to 1.

    Returns:
        The plans that solve the game, those that do not, and the number of drawn plans. A plan is its times, 0 after
        the end of the episode, then solved, blocks removed and seconds played.

    Raises:
        ValueError: one line naming the argument and what was expected; also if all plans were drawn, and too few are of
            a kind that is wanted.
        RuntimeError: a world has a fault; one line.
    """
    scene = scene_of(game)
    for name, wanted in (("num_succeed", num_succeed), ("num_fail", num_fail)):
        check_whole(name, wanted, 0, MOST_PLANS)
    check_whole("seed", seed, 0, 2**32 - 1)
    check_least("epsilon", epsilon, 0, 1)
    instants = _instants(scene, interval, max_game_time, max_action_time, max_step)
    plans = draw_plans(instants, len(scene.eliminable_blocks), max_step, seed, epsilon)
    succeeded: list[Action] = []
    failed: list[Action] = []
    drawn = 0
    for plan, (solved, removed, seconds) in _score_in_batches(scene, plans):
        if _enough(succeeded, num_succeed, failed, num_fail):
            break
        drawn += 1
        done = [float(t * (t <= seconds)) for t in plan]
        chosen, wanted = (succeeded, num_succeed) if solved else (failed, num_fail)
        if len(chosen) < wanted:
            chosen.append([*done, solved, removed, seconds])
    if not _enough(succeeded, num_succeed, failed, num_fail):
        raise ValueError(f"interval: expected more instants, because all plans were drawn, {drawn} of them")
    return succeeded, failed, drawn


def _enough(succeeded: list[Action], num_succeed: int, failed: list[Action], num_fail: int) -> bool:
    return len(succeeded) >= num_succeed and len(failed) >= num_fail


def _instants(
    scene: Scene, interval: float, max_game_time: float, max_action_time: float, max_step: int
) -> list[float]:
    """Return the times to draw from, s."""
    blocks = len(scene.eliminable_blocks)
    check_positive("max_game_time", max_game_time)
    if check_positive("max_action_time", max_action_time, most=MOST_SECONDS) > max_game_time:
        raise ValueError(f"max_action_time: expected seconds from 0 to {max_game_time}, got {max_action_time!r}")
    if check_whole("max_step", max_step, 0, MOST_OBJECTS) < blocks:
        raise ValueError(f"max_step: expected at least the {blocks} blocks of {scene.name}, got {max_step!r}")
    if check_positive("interval", interval) < max_action_time / MOST_INSTANTS:
        most = f"at most {MOST_INSTANTS} instants below {max_action_time} s"
        raise ValueError(f"interval: expected {most}, got {interval!r}")
    instants = list(np.arange(0, max_action_time, interval))
    if len(instants) < blocks:
        raise ValueError(f"interval: expected at least {blocks} instants below {max_action_time} s, got {interval!r}")
    return instants


def _score_in_batches(scene: Scene, plans: Iterator[Action]) -> Iterator[tuple[Action, tuple[int, int, float]]]:
    """Play plans batch by batch; yield each with solved, blocks removed and seconds."""
    for first in count(2, BATCH):  # the official function resets once before the first plan
        batch = list(islice(plans, BATCH))
        if not batch:
            return
        full = batch + batch[-1:] * (BATCH - len(batch))
        yield from zip(batch, _score_plans(scene, full, first)[: len(batch)], strict=True)


def draw_plans(instants: list[float], blocks: int, slots: int, seed: int, epsilon: float) -> Iterator[Action]:
    """Draw plans until there are no others, with the random numbers in the official order.

    Args:
        instants: s, the times to draw from.
        blocks: how many times to draw.
        slots: of a plan; those beyond the blocks are 0.
        seed: of both official streams.
        epsilon: probability that a time becomes 0.
    """
    generator, noise = random.Random(seed), np.random.RandomState(seed)  # noqa: S311  # the official streams
    drawn: set[tuple[float, ...]] = set()
    while True:
        for _ in range(REPEATS):
            times = generator.sample(instants, blocks)
            if tuple(times) not in drawn:
                break
        else:
            return
        times = [t * (noise.uniform() > epsilon) for t in times]
        times += [0.0] * (slots - blocks)
        drawn.add(tuple(times))
        yield times


def _score_plans(scene: Scene, plans: list[Action], resets: int) -> list[tuple[int, int, float]]:
    """Play plans in successive resets of one space; return solved, blocks removed and seconds of each."""
    compiled = [compile_scene(scene, resets=resets + k, dtype=DTYPE) for k in range(len(plans))]
    steps = plan_to_steps(np.array(plans), PEOPLE_FPS, "simulate").astype(np.int32)
    program = Score(compiled[0][0], DTYPE, BATCH, steps.shape[1])
    worlds = world_layout(program.topology, DTYPE).pack_many([world for _, world in compiled])
    frames = np.array([len(official_clock(PEOPLE_FPS))], np.int32)
    counts = executable(program)(
        worlds, np.ascontiguousarray(steps.T), pack_timing(step_timing(PEOPLE_FPS, DTYPE)), frames
    )[0]
    solved, removed, fault = counts[0], counts[2], counts[3]
    if fault.any():
        raise RuntimeError(f"{scene.name}: the world is no longer sound (fault {fault.max()})")
    instants = official_clock(PEOPLE_FPS)
    seconds = np.append(instants, instants[-1] + 1 / PEOPLE_FPS)[counts[1]]
    return [(int(good), int(gone), float(end)) for good, gone, end in zip(solved, removed, seconds, strict=True)]
