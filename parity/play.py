"""Play one game's plans in the reference and in ours, and compare them."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

import iphyre_jax
from iphyre_jax import Scene
from parity.compare import PlanComparison, compare_plans
from parity.plans import PlanSet, random_plans
from parity.reference import Trajectory, run

DURATION = 15.0  # s, the length of an official play


@dataclass(frozen=True)
class Task:
    """One game to compare.

    Attributes:
        scene: a game's name or the path of a scene file.
        plans: number of random plans.
        rates: frame rates, each with plans of its own made from the same removal times.
        dtypes: types to run ours in.
        resets: number of the reset to play in.
        seed: seed of the plans.
        plan_set: which random plans, see `parity.plans.random_times`.
        duration: s, length of a play.
    """

    scene: str
    plans: int
    rates: tuple[int, ...]
    dtypes: tuple[str, ...]
    resets: int
    seed: int
    plan_set: PlanSet = "early"
    duration: float = DURATION


@dataclass(frozen=True, eq=False)
class GameResult:
    """One game at one frame rate and in one type.

    Attributes:
        game: the scene's name.
        fps: physics steps a second.
        dtype: the type ours ran in.
        eliminate_at: (B, S) the plans.
        comparison: what came out.
    """

    game: str
    fps: int
    dtype: str
    eliminate_at: NDArray[np.int32]
    comparison: PlanComparison


def play_reference(
    scene: Scene, eliminate_at: NDArray[np.int32], fps: int, duration: float, resets: int
) -> list[Trajectory]:
    """Play every row of `eliminate_at` (B, S) in the reference, sampled after every step."""
    steps = round(duration * fps)
    return [run(scene, row, fps=fps, steps=steps, resets=resets) for row in eliminate_at]


def compare_game(task: Task) -> list[GameResult]:
    """Play and compare one game at every rate and in every type; the reference plays once a rate.

    Args:
        task: the game and the circumstances.

    Returns:
        One result for each rate and type, in that nesting.

    Raises:
        ValueError: what `iphyre_jax.load_scene` and `iphyre_jax.simulate` raise.
        FileNotFoundError: if a scene file is missing.
    """
    scene = iphyre_jax.load_scene(task.scene)
    results = []
    for fps in task.rates:
        eliminate_at = random_plans(scene, task.plans, fps, task.seed, task.plan_set)
        references = play_reference(scene, eliminate_at, fps, task.duration, task.resets)
        for dtype in task.dtypes:
            ours = iphyre_jax.simulate(
                scene,
                eliminate_at,
                fps=fps,
                duration=task.duration,
                dtype=dtype,
                sample_every=1,
                resets=task.resets,
            )
            comparison = compare_plans(references, ours, scene.dynamic)
            results.append(GameResult(scene.name, fps, dtype, eliminate_at, comparison))
    return results


def compare_games(tasks: list[Task], workers: int) -> Iterator[tuple[int, list[GameResult]]]:
    """Compare many games, in `workers` processes if that is more than 1.

    Args:
        tasks: the games.
        workers: processes to use.

    Yields:
        The index of a task and its results, as each is done.
    """
    if workers == 1:
        yield from enumerate(map(compare_game, tasks))
        return
    # A fresh interpreter a worker: a forked one would inherit JAX's threads in an undefined state.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        pending = {pool.submit(compare_game, task): index for index, task in enumerate(tasks)}
        for future in as_completed(pending):
            yield pending[future], future.result()
