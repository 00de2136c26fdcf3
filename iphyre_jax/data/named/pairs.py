"""Edge pairs: two plans of a scene that differ by one small move, of which one solves it and the other does not.

Either one removal is moved by 0.1 s, or two removals change places. No count of removals and no knowledge of the game
tells the two apart; chance is one half. The search looks at the neighbours of random plans that solve the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, islice
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.collection import build
from iphyre_jax.data.dataset import Dataset, scene_entry
from iphyre_jax.data.draws import INTERVAL, OFFICIAL_SECONDS, Plan, random_plans
from iphyre_jax.data.journal import Journal
from iphyre_jax.data.labels import Labels, PlayProtocol, label_plans
from iphyre_jax.data.recipe import Recipe, check_poses
from iphyre_jax.data.search import STALE, play_keys
from iphyre_jax.scenes import Scene

ROUND: Final = 256  # draws of a scene at a time
PAIR_STREAM: Final = 2  # beside the seed, so that the choice draws other numbers than anything else

Tenths = npt.NDArray[np.int64]


@dataclass
class _PairSearch:
    """The pairs of one scene so far: plans in tenths of a second, the one that solves it first."""

    known: set[bytes]
    draws: int = 0
    plans: list[Tenths] = field(default_factory=list)
    ends: list[Labels] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)  # of the draws
    tried: set[bytes] = field(default_factory=set)  # plans whose neighbours were looked at
    stale: int = 0  # draws in a row that brought no new plan

    def pairs(self) -> int:
        """Return how many pairs there are."""
        return len(self.plans) // 2

    def next_plans(self, stream: Iterator[Plan], most: int) -> tuple[Tenths, Tenths]:
        """Draw a round of plans; return the new ones, (B, S) tenths of a second, and the numbers of their draws."""
        plans = [np.rint(np.array(plan) / INTERVAL).astype(np.int64) for plan in islice(stream, most)]
        is_new = []
        for plan in plans:
            is_new.append(plan.tobytes() not in self.tried)
            self.tried.add(plan.tobytes())
        self.stale = 0 if any(is_new) else self.stale + max(len(plans), 1)
        new = np.flatnonzero(is_new)
        numbers = self.draws + new
        self.draws += len(plans)
        return np.array(plans, np.int64).reshape(len(plans), -1)[new], numbers


def moved_plans(plan: Tenths) -> list[Tenths]:
    """Return the neighbours of a plan, (S,) tenths of a second, 0 for a block that stays.

    One removal is moved by one tenth, from 0.1 to 6.9 s and onto no other; or two removals change places.
    """
    last = round(OFFICIAL_SECONDS / INTERVAL) - 1
    removed = np.flatnonzero(plan).tolist()
    found = []
    for slot in removed:
        for tenth in (plan[slot] - 1, plan[slot] + 1):
            if 1 <= tenth <= last and tenth not in plan:
                found.append(np.where(np.arange(len(plan)) == slot, tenth, plan))
    for one, other in combinations(removed, 2):
        swapped = plan.copy()
        swapped[[one, other]] = plan[[other, one]]
        found.append(swapped)
    return found


def edge_pairs(
    scenes: Sequence[Scene], count: int, recipe: Recipe, known: Sequence[set[bytes]], journal: Journal
) -> Dataset:
    """Find pairs of each scene, at most one for each random plan that solves it.

    Args:
        scenes: to search.
        count: pairs of each scene; it has fewer if `recipe.max_draws` random plans do not suffice. `support` has none:
            all of its plans with both removals solve it.
        recipe: its protocol, seed, sequences and split are used.
        known: plays of each scene that no pair may contain, as `play_keys` gives them.
        journal: keeps what is done.

    Returns:
        Rows 2 k and 2 k + 1 are a pair, the play that solves the scene first; `draw` is the number of the random plan.
    """
    check_poses(recipe, scenes, 2 * count * len(scenes))
    streams = [random_plans(scene, "official", recipe.seed) for scene in scenes]
    searches = [_PairSearch(set(plays)) for plays in known]
    rngs = [np.random.default_rng([recipe.seed, PAIR_STREAM, index]) for index in range(len(scenes))]
    while active := [k for k, search in enumerate(searches) if _goes_on(search, count, recipe.max_draws)]:
        found = {
            k: searches[k].next_plans(streams[k], min(ROUND, recipe.max_draws - searches[k].draws)) for k in active
        }
        drawn = {k: plans for k, (plans, _) in found.items()}
        labels = _label(scenes, drawn, recipe.protocol, journal)
        solved = {k: np.flatnonzero(labels[k].success & (labels[k].fault == 0)) for k in active}
        nearby = {k: [moved_plans(drawn[k][row]) for row in solved[k]] for k in active}
        flat = {k: np.array([plan for plans in nearby[k] for plan in plans]) for k in active if any(nearby[k])}
        ends = _label(scenes, flat, recipe.protocol, journal)
        for k in flat:
            groups = np.split(np.arange(len(flat[k])), np.cumsum([len(plans) for plans in nearby[k]])[:-1])
            for row, group in zip(solved[k], groups, strict=True):
                base = (drawn[k][row], labels[k].take(np.array([row])), int(found[k][1][row]))
                if searches[k].pairs() < count:
                    _add_pair(searches[k], base, flat[k][group], ends[k].take(group), rngs[k], recipe.protocol)
        journal.report(f"{sum(s.pairs() for s in searches)} of {count * len(scenes)} pairs")
    return _dataset(scenes, searches, recipe, journal)


def _goes_on(search: _PairSearch, count: int, most: int) -> bool:
    return search.pairs() < count and search.draws < most and search.stale < STALE


def _label(
    scenes: Sequence[Scene], plans: dict[int, Tenths], protocol: PlayProtocol, journal: Journal
) -> dict[int, Labels]:
    """Play the plans of some scenes together."""
    there = {k: rows for k, rows in plans.items() if len(rows)}
    empty = {k: Labels.join([]) for k in plans if k not in there}
    if not there:
        return empty
    game = np.repeat(list(there), [len(rows) for rows in there.values()])
    steps = protocol.steps(np.concatenate(list(there.values())) * INTERVAL)
    labels = label_plans(scenes, game, steps, protocol, None, journal)
    return empty | {k: labels.take(game == k) for k in there}


def _add_pair(
    search: _PairSearch,
    base: tuple[Tenths, Labels, int],
    others: Tenths,
    ends: Labels,
    rng: np.random.Generator,
    protocol: PlayProtocol,
) -> None:
    """Add a plan that solves the scene with one of its neighbours that do not, chosen by chance."""
    plan, end, number = base
    own = play_keys(protocol.steps(plan[None] * INTERVAL), end.end_step)[0]
    if own in search.known or not len(others):
        return
    keys = play_keys(protocol.steps(others * INTERVAL), ends.end_step)
    failed = [k for k, key in enumerate(keys) if not ends.success[k] and not ends.fault[k] and key not in search.known]
    if failed:
        chosen = failed[rng.integers(len(failed))]
        search.known |= {own, keys[chosen]}
        search.plans += [plan, others[chosen]]
        search.ends += [end, ends.take(np.array([chosen]))]
        search.numbers += [number, number]


def _dataset(scenes: Sequence[Scene], searches: Sequence[_PairSearch], recipe: Recipe, journal: Journal) -> Dataset:
    plans = [np.array(plan * INTERVAL) for search in searches for plan in search.plans]
    ends = Labels.join([end for search in searches for end in search.ends])
    columns = ends.columns(np.array([number for search in searches for number in search.numbers], np.int32))
    game = np.repeat(np.arange(len(scenes)), [len(search.plans) for search in searches])
    entries = [
        {**scene_entry(scene), "draws": search.draws, "successes": search.pairs(), "failures": search.pairs()}
        for scene, search in zip(scenes, searches, strict=True)
    ]
    times = np.array(plans).reshape(-1, scenes[0].limits.blocks)
    return build(scenes, game, times, columns, recipe, journal, {"scenes": entries})
