"""Play the plans of scenes in both engines and compare."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import active_children, get_context

import numpy as np
from numpy.typing import NDArray

import iphyre_jax
from iphyre_jax import Scene, Simulation
from parity.compare import BIN, PlanComparison, compare_plans
from parity.divergences import DivergedPlan, diverged_plans, explain
from parity.engines.reference import run
from parity.engines.trajectory import Trajectory
from parity.plans import PlanSet, random_plans
from parity.statistics import PlayStatistics, play_statistics

DURATION = 15.0  # s, the length of an official play


@dataclass(frozen=True)
class Task:
    """Scenes to compare, best of one topology, so that their plays share chunks.

    Attributes:
        scenes: games' names, paths of scene files, or scenes.
        plans: random plans a scene.
        rates: frame rates; the same removal times in seconds become each one's plans.
        dtypes: types to run ours in.
        resets: number of the reset to play in.
        seed: seed of the plans.
        plan_set: which random plans, see `parity.plans.random_times`.
        duration: s, length of a play.
        perturbations: relative changes of gravity; the reference plays once more under each.
        explained: how many of a scene's diverged plans in float64 are traced to their first difference.
        statistics: s of one play of each scene in which energy, momentum and contacts are counted; 0 for none.
    """

    scenes: tuple[str | Scene, ...]
    plans: int
    rates: tuple[int, ...]
    dtypes: tuple[str, ...]
    resets: int
    seed: int
    plan_set: PlanSet = "early"
    duration: float = DURATION
    perturbations: tuple[float, ...] = ()
    explained: int = 3
    statistics: float = 0.0


@dataclass(frozen=True, eq=False)
class GameResult:
    """One scene at one frame rate and in one type.

    Attributes:
        scene: the scene.
        fps: physics steps a second.
        dtype: the type ours ran in.
        eliminate_at: (B, S) the plans.
        comparison: how far they differ.
        sensitivity: by relative change of gravity, the reference under that gravity against the reference.
        worst: both engines' plays of the plan with the largest error; None if no pose in play differs.
        diverged: the plans that diverge; in float64 the first ones are traced.
        statistics: energy, momentum and contacts of one play, if asked for.
    """

    scene: Scene
    fps: int
    dtype: str
    eliminate_at: NDArray[np.int32]
    comparison: PlanComparison
    sensitivity: dict[float, PlanComparison] = field(default_factory=dict)
    worst: WorstPlan | None = None
    diverged: tuple[DivergedPlan, ...] = ()
    statistics: PlayStatistics | None = None

    @property
    def game(self) -> str:
        """The scene's name."""
        return self.scene.name


@dataclass(frozen=True, eq=False)
class WorstPlan:
    """Both engines' plays of a scene's plan with the largest error, sampled every `BIN` seconds.

    Attributes:
        plan: its index.
        reference: (K, N, 3) float32, poses of all objects.
        ours: (K, N, 3) float32.
    """

    plan: int
    reference: NDArray[np.float32]
    ours: NDArray[np.float32]


def play_reference(
    scene: Scene, eliminate_at: NDArray[np.int32], fps: int, duration: float, resets: int, gravity: float = 1.0
) -> list[Trajectory]:
    """Play every row of `eliminate_at` (B, S) in the reference, sampled after every step."""
    steps = round(duration * fps)
    return [run(scene, row, fps=fps, steps=steps, resets=resets, gravity=gravity) for row in eliminate_at]


def as_simulation(trajectories: list[Trajectory]) -> Simulation:
    """The reference's plays as a `Simulation`, to compare the reference with itself."""
    size = len(trajectories)
    return Simulation(
        success=np.array([one.success for one in trajectories]),
        steps=np.array([one.steps for one in trajectories]),
        eliminations=np.array([one.eliminations for one in trajectories]),
        reward=np.full(size, np.nan),
        fault=np.zeros(size, np.int64),
        samples=np.stack([one.samples for one in trajectories]),
    )


def play_ours(
    scenes: list[Scene], plans: list[NDArray[np.int32]], fps: int, dtype: str, task: Task
) -> Iterator[Simulation]:
    """Play plans (B, S) of several scenes in one call; yield one result a scene, sampled after every step."""
    which = np.repeat(np.arange(len(scenes)), [len(rows) for rows in plans])
    width = max(rows.shape[1] for rows in plans)
    table = np.concatenate([np.pad(rows, ((0, 0), (0, width - rows.shape[1])), constant_values=-1) for rows in plans])
    options = {"fps": fps, "duration": task.duration, "dtype": dtype, "sample_every": 1, "resets": task.resets}
    results = iphyre_jax.simulate_many(scenes, which, table, **options)  # type: ignore[arg-type]  # values of several types
    for index, scene in enumerate(scenes):
        rows = which == index
        fields = {name: value[rows] for name, value in vars(results).items()}
        yield Simulation(**fields | {"samples": fields["samples"][:, :, : scene.n_objects]})


def compare_scenes(task: Task) -> list[GameResult]:
    """Play and compare scenes at every rate and in every type; the reference plays once for each rate.

    Args:
        task: the scenes and how to play them.

    Returns:
        One result for each scene, rate and type, in that order.

    Raises:
        ValueError: from `iphyre_jax.load_scene` or `iphyre_jax.simulate_many`.
        FileNotFoundError: a scene file is missing.
    """
    scenes = [iphyre_jax.load_scene(scene) for scene in task.scenes]
    results: dict[tuple[int, int, int], GameResult] = {}
    for r, fps in enumerate(task.rates):
        plans = [random_plans(scene, task.plans, fps, task.seed, task.plan_set) for scene in scenes]
        timing = fps, task.duration, task.resets
        references = [play_reference(scene, rows, *timing) for scene, rows in zip(scenes, plans, strict=True)]
        sensitivities = [_sensitivity(*game, task, fps) for game in zip(scenes, plans, references, strict=True)]
        for d, dtype in enumerate(task.dtypes):
            for s, ours in enumerate(play_ours(scenes, plans, fps, dtype, task)):
                compared = compare_plans(references[s], ours, scenes[s].dynamic, fps)
                results[s, r, d] = GameResult(
                    scene=scenes[s],
                    fps=fps,
                    dtype=dtype,
                    eliminate_at=plans[s],
                    comparison=compared,
                    sensitivity=sensitivities[s],
                    worst=_worst(references[s], ours, compared, fps),
                    diverged=_diverged(scenes[s], plans[s], compared, fps, dtype, task),
                    statistics=_statistics(scenes[s], plans[s], fps, task) if d == 0 else None,
                )
    return [results[key] for key in sorted(results)]


def _diverged(
    scene: Scene, plans: NDArray[np.int32], compared: PlanComparison, fps: int, dtype: str, task: Task
) -> tuple[DivergedPlan, ...]:
    steps = round(task.duration * fps)
    return tuple(
        explain(scene, plans, compared, int(plan), fps, dtype, steps, task.resets, traced=number < task.explained)
        for number, plan in enumerate(diverged_plans(compared, fps, dtype))
    )


def _statistics(scene: Scene, plans: NDArray[np.int32], fps: int, task: Task) -> PlayStatistics | None:
    """Count in the first plan that removes something."""
    plan = min(1, len(plans) - 1)
    steps = round(min(task.statistics, task.duration) * fps)
    return play_statistics(scene, plans[plan], plan=plan, fps=fps, steps=steps, resets=task.resets) if steps else None


def _sensitivity(
    scene: Scene, eliminate_at: NDArray[np.int32], references: list[Trajectory], task: Task, fps: int
) -> dict[float, PlanComparison]:
    """The reference under each perturbed gravity against itself."""
    compared = {}
    for part in task.perturbations:
        perturbed = play_reference(scene, eliminate_at, fps, task.duration, task.resets, 1.0 + part)
        compared[part] = compare_plans(references, as_simulation(perturbed), scene.dynamic, fps)
    return compared


def _worst(references: list[Trajectory], ours: Simulation, comparison: PlanComparison, fps: int) -> WorstPlan | None:
    assert ours.samples is not None  # noqa: S101  `play_ours` samples
    plan, every = int(comparison.error.argmax()), max(1, round(BIN * fps))
    if not comparison.error[plan]:
        return None
    pair = references[plan].samples, ours.samples[plan]
    return WorstPlan(plan, *(samples[::every].astype(np.float32) for samples in pair))


def compare_games(tasks: list[Task], workers: int) -> Iterator[tuple[int, list[GameResult]]]:
    """Compare many scenes, in this process or in several workers.

    Args:
        tasks: the scenes.
        workers: processes; 1 for this one.

    Yields:
        A task's index and its results, as soon as it is done.
    """
    if workers == 1:
        yield from enumerate(map(compare_scenes, tasks))
        return
    # A forked worker would inherit JAX's threads in an undefined state.
    others = active_children()
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_ignore_interrupts)
    try:
        pending = {pool.submit(compare_scenes, task): index for index, task in enumerate(tasks)}
        for future in as_completed(pending):
            yield pending[future], future.result()
    except BaseException:  # Ctrl-C too: what is under way would take minutes
        pool.shutdown(wait=False, cancel_futures=True)
        for child in active_children():
            if child not in others:
                child.terminate()
        raise
    pool.shutdown()


def _ignore_interrupts() -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the one that has the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
