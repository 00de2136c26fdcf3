"""Search of a game's plans, at any rate: random plans, all single removals, neighbours of the best, all pairs; a climb.

No plan is entered by hand. What was tried stays together with how it ended, because orders that solve are read off it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.rules import DECISIONS_PER_SECOND, NEVER, TIME_LIMIT
from iphyre_jax.scenes import MAX_ELIMINABLE, Scene
from iphyre_jax.simulation import simulate_many

LATEST: Final = 7.0  # s, latest random removal; the best known plans end earlier
BATCH: Final = 2048  # random plans at a time
ENOUGH: Final = 64  # solved plans, after which random search ends
KEPT: Final = 32  # plans whose neighbours are tried
KEPT_OF_SET: Final = 4  # of them with the same removed blocks
SPREADS: Final = (0.5, 0.2, 0.1, 0.05, 0.02)  # s, standard deviation of neighbours in each round
DECIDED: Final = 64  # best plans that are played again in float64
CLIMBED: Final = 8  # best plans whose changes are tried
PAIR_STEPS: Final = 6  # by which two removals move at most
CHUNK: Final = 50_000  # plans of an enumeration at a time
TRIPLES_BEFORE: Final = 6.4  # s; triples are enumerated with all removals before, on the grid of 10 steps a second

Plans = npt.NDArray[np.int64]


@dataclass
class Tried:
    """Plans of a game that were played.

    Attributes:
        scene: the game.
        fps: physics steps a second.
        resets: number of the reset.
        plans: (N, S) steps, -1 for never.
        reward: (N,) points.
        success: (N,) bool.
        steps: (N,) physics steps played.
        enumerated: which sets of plans are complete, by words.
    """

    scene: Scene
    fps: int
    resets: int
    plans: Plans = field(default_factory=lambda: np.zeros((0, 0), np.int64))
    reward: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    success: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    steps: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    enumerated: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.plans = self.plans.reshape(len(self.plans), len(self.scene.eliminable_blocks))

    def play(self, plans: Plans, *, dtype: str = "float32", keep_failures: bool = True) -> int:
        """Play plans and keep them with their ends; returns how many solve the game."""
        reward, success, steps = play_plans_of(self.scene, plans, self.fps, self.resets, dtype)
        kept = np.ones(len(plans), bool) if keep_failures else success
        self.plans = np.concatenate([self.plans, plans[kept]])
        self.reward = np.concatenate([self.reward, reward[kept]])
        self.success = np.concatenate([self.success, success[kept]])
        self.steps = np.concatenate([self.steps, steps[kept]])
        return int(success.sum())

    def best(self, count: int) -> Plans:
        """Return the best plans, (count, S), at most `KEPT_OF_SET` of which remove the same blocks; no plan twice."""
        rows: list[int] = []
        of_set: dict[bytes, int] = {}
        met = set()
        for row in np.argsort(-self.reward, kind="stable").tolist():
            plan, blocks = self.plans[row].tobytes(), (self.plans[row] != NEVER).tobytes()
            if plan in met or of_set.get(blocks, 0) >= KEPT_OF_SET:
                continue
            met.add(plan)
            of_set[blocks] = of_set.get(blocks, 0) + 1
            rows.append(row)
            if len(rows) == count:
                break
        return self.plans[rows]


def play_plans_of(
    scene: Scene, plans: Plans, fps: int, resets: int, dtype: str = "float32"
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Play plans (N, S) of steps; returns reward, success and steps played, each (N,).

    All games of a topology share a program, whatever their number of blocks.
    """
    wide = np.pad(plans, ((0, 0), (0, MAX_ELIMINABLE - plans.shape[1])), constant_values=NEVER)
    played = simulate_many([scene], np.zeros(len(plans), np.int64), wide, fps=fps, resets=resets, dtype=dtype)
    return played.reward, played.success, played.steps


def search_plans(scene: Scene, fps: int, resets: int, known: Sequence[Sequence[int]], most: int, seed: int) -> Tried:
    """Try many plans of a game.

    Args:
        scene: the game.
        fps: physics steps a second.
        resets: number of the reset.
        known: plans that an earlier search found, whose neighbours are tried too.
        most: random plans at most; fewer if `ENOUGH` solve the game.
        seed: of the random numbers.
    """
    rng, tried = np.random.default_rng(seed), Tried(scene, fps, resets)
    blocks, last = len(scene.eliminable_blocks), round(TIME_LIMIT * fps)
    for removals, name in enumerate(("no removal", "one removal")):
        _enumerate(tried, removals, last, name)
    if known:
        tried.play(np.array(known, np.int64).reshape(-1, blocks))
    for _ in range(0, most, BATCH):
        tried.play(with_distinct_steps(random_plans(rng, BATCH, blocks, fps)))
        if tried.success.sum() >= ENOUGH:
            break
    if fps == DECISIONS_PER_SECOND and not tried.success.any():
        _enumerate(tried, 2, last, "two removals")
        _enumerate(tried, 3, round(TRIPLES_BEFORE * fps), f"three removals before {TRIPLES_BEFORE} s")
    for spread in SPREADS:
        tried.play(neighbours(rng, tried.best(KEPT), BATCH // 2, spread * fps, last))
    _climb(tried)
    return tried


def _climb(tried: Tried) -> None:
    """Try the changes of the best plans until none is better.

    A plan's changes: one removal at any other step of the play or none, or two removals a few steps earlier or later.
    """
    best = -np.inf
    while tried.success.any() and tried.reward.max() > best:
        best, last = tried.reward.max(), int(tried.steps[tried.reward.argmax()])
        plans = np.concatenate([_changes(plan, last) for plan in tried.best(CLIMBED)])
        tried.play(np.unique(with_distinct_steps(plans), axis=0), keep_failures=False)


def _changes(plan: npt.NDArray[np.int64], last: int) -> Plans:
    """Return the changes of a plan (S,) that `_climb` tries, (N, S); steps 1 to `last`."""
    changed = []
    for block in range(len(plan)):
        single = np.tile(plan, (last + 1, 1))
        single[:, block] = [NEVER, *range(1, last + 1)]
        changed.append(single)
    near = np.array(list(itertools.product(range(-PAIR_STEPS, PAIR_STEPS + 1), repeat=2)))
    for pair in itertools.combinations(np.flatnonzero(plan != NEVER), 2):
        moved = np.tile(plan, (len(near), 1))
        moved[:, pair] = np.maximum(plan[list(pair)] + near, 1)
        changed.append(moved)
    return np.concatenate(changed)


def random_plans(rng: np.random.Generator, count: int, blocks: int, fps: int) -> Plans:
    """Return random plans (count, blocks). In half of them all removals happen within one second."""
    spread = rng.uniform(0, LATEST, (count, blocks))
    burst = rng.uniform(0, LATEST - 1, (count, 1)) + rng.uniform(0, 1, (count, blocks))
    steps = np.rint(np.where(rng.random((count, 1)) < 0.5, spread, burst) * fps).astype(np.int64) + 1
    removed = rng.integers(0, 1 + blocks, (count, 1)) > rng.permuted(np.tile(np.arange(blocks), (count, 1)), axis=1)
    return np.where(removed, steps, NEVER)


def with_distinct_steps(plans: Plans) -> Plans:
    """Return the plans that remove at most one block before each step."""
    ordered = np.sort(plans, axis=1)
    same = (np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] != NEVER)
    return plans[~same.any(axis=1)]


def _enumerate(tried: Tried, removals: int, last: int, name: str) -> None:
    """Try every plan with so many removals before step `last`, in float64: what none of them solves, none solves."""
    for chunk in _grid(len(tried.scene.eliminable_blocks), removals, last):
        tried.play(chunk, dtype="float64", keep_failures=removals < 2)
    if len(tried.scene.eliminable_blocks) >= removals:
        tried.enumerated.append(name)


def _grid(blocks: int, removals: int, last: int) -> Iterator[Plans]:
    """Yield all plans with so many removals at different steps 1 to last - 1, (N, blocks)."""
    steps = np.array(list(itertools.permutations(range(1, last), removals)), np.int64)
    for removed in itertools.combinations(range(blocks), removals):
        plans = np.full((len(steps), blocks), NEVER)
        plans[:, list(removed)] = steps
        for first in range(0, len(plans), CHUNK):
            yield plans[first : first + CHUNK]


def neighbours(rng: np.random.Generator, best: Plans, count: int, spread: float, last: int) -> Plans:
    """Return plans near some others: each time moves with a probability of one half; one in ten is dropped.

    Args:
        rng: source of the random numbers.
        best: (N, S) plans.
        count: plans to make; those with equal steps are left out.
        spread: steps, standard deviation of a move; at least one step.
        last: steps of an episode.
    """
    near = best[rng.integers(0, len(best), count)]
    moved = near + np.rint(rng.normal(0, max(spread, 1.0), near.shape)).astype(np.int64)
    moved = np.where(rng.random(near.shape) < 0.5, near, np.clip(moved, 1, last - 1))
    moved = np.where((near == NEVER) | (rng.random(near.shape) < 0.1), NEVER, moved)
    return with_distinct_steps(moved)


def decide(tried: Tried) -> tuple[Plans, float, bool, int]:
    """Return the best plan, (S,), its reward, whether it solves and its steps, decided in float64.

    Entries after the end of the play are cut; of equal plans the first counts.
    """
    order = np.argsort(-tried.reward, kind="stable")[:DECIDED]
    reward, success, steps = play_plans_of(tried.scene, tried.plans[order], tried.fps, tried.resets, "float64")
    best = int(np.argmax(reward))
    plan = tried.plans[order[best]]
    return np.where(plan < steps[best], plan, NEVER), float(reward[best]), bool(success[best]), int(steps[best])
