"""`collect`: draw plans and play them, until each game has enough that solve it and enough that do not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_SEED, check_option, check_whole, show, whole_fps
from iphyre_jax.data.dataset import MAX_STEPS, SCHEMA, VERSION, Dataset, scene_entry
from iphyre_jax.data.draws import Plan, random_plans
from iphyre_jax.data.labels import DTYPE, FRESH, Outcomes, frames, label_plans
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.provenance import provenance
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.library import SceneLike, load_scenes

DISTRIBUTIONS: Final = ("official", "uniform15")
MOST_FPS: Final = int(MAX_STEPS / TIME_LIMIT) - 1  # a step's number is an int16
MOST_OF_A_KIND: Final = 100_000
MOST_DRAWS: Final = 100_000  # of a game; some games are solved by one plan in a thousand
FIRST_ROUND: Final = 2.6  # draws of a game for each play wanted


@dataclass
class _Search:
    """The draws of one scene so far."""

    plans: Iterator[Plan]
    wanted: tuple[int, int]  # successes, failures
    most: int
    times: list[Plan] = field(default_factory=list)
    played: list[Outcomes] = field(default_factory=list)
    exhausted: bool = False

    def outcome(self, name: str) -> npt.NDArray[Any]:
        """Return a column of the outcomes of all draws."""
        return np.concatenate([np.zeros(0, bool), *(getattr(part, name) for part in self.played)])

    def rows(self, solved: bool) -> npt.NDArray[np.intp]:
        """Return the draws of a kind that are kept: the first ones, as many as are wanted."""
        success, fault = self.outcome("success"), self.outcome("fault")
        return np.flatnonzero((success == solved) & (fault == 0))[: self.wanted[0 if solved else 1]]

    def next_draws(self) -> list[Plan]:
        """Draw as many plans as will probably do; none if there are enough of both kinds, or no more allowed."""
        missing = [wanted - len(self.rows(solved)) for wanted, solved in zip(self.wanted, (True, False), strict=True)]
        if max(missing) <= 0 or self.exhausted:
            return []
        made, solved = len(self.times), float(self.outcome("success").sum())
        rate = (solved + 1) / (made + 4)
        likely = max(missing[0] / rate, missing[1] / (1 - rate)) if made else FIRST_ROUND * max(missing)
        count = min(int(1.1 * likely) + 8, 4 * made + 256, self.most - made)
        drawn = list(islice(self.plans, count))
        self.exhausted = len(drawn) < count or made + len(drawn) >= self.most
        self.times += drawn
        return drawn


def collect(
    games: Sequence[SceneLike],
    *,
    successes: int = 50,
    failures: int = 50,
    distribution: str = "official",
    fps: int = 60,
    seed: int = 0,
    max_draws: int = MOST_DRAWS,
) -> Dataset:
    """Draw plans of each game until enough solve it and enough do not, as the official loop does; play on all cores.

    Args:
        games: names, scene files or Scenes.
        successes: plays of each game that solve it, 0 to 100,000.
        failures: plays that do not.
        distribution: "official" (the plans of the official function) or "uniform15" (times up to 15 s).
        fps: physics steps a second.
        seed: of the draws, 0 to 2**32 - 1.
        max_draws: of one game; it has fewer plays if they do not suffice.

    Raises:
        ValueError: one line naming the argument and what was expected.
        OSError: a scene file cannot be read.
    """
    scenes = load_scenes(games)
    rate = _check(successes, failures, distribution, fps, seed, max_draws)
    searches = [_Search(random_plans(scene, distribution, seed), (successes, failures), max_draws) for scene in scenes]
    while any(drawn := [search.next_draws() for search in searches]):
        _play(scenes, searches, drawn, rate)
    settings = {"distribution": distribution, "form": "fresh", "fps": rate, "rule": "simulate", "frames": frames(rate)}
    settings |= {"resets": FRESH, "dtype": DTYPE, "seed": seed, "split": "train"}
    return _dataset(scenes, searches, settings)


def _check(successes: int, failures: int, distribution: str, fps: int, seed: int, max_draws: int) -> int:
    check_whole("successes", successes, 0, MOST_OF_A_KIND)
    check_whole("failures", failures, 0, MOST_OF_A_KIND)
    check_option("distribution", distribution, DISTRIBUTIONS)
    check_whole("seed", seed, 0, min(2**32 - 1, MAX_SEED))
    check_whole("max_draws", max_draws, 1, 10 * MOST_DRAWS)
    if (rate := whole_fps(fps)) > MOST_FPS:
        raise ValueError(f"fps: expected at most {MOST_FPS} physics steps a second, got {show(fps)}")
    return rate


def _play(scenes: Sequence[Scene], searches: list[_Search], drawn: list[list[Plan]], fps: int) -> None:
    """Play one round of draws, of all scenes together."""
    counts = [len(plans) for plans in drawn]
    game = np.repeat(np.arange(len(scenes)), counts)
    times = np.array([plan for plans in drawn for plan in plans])
    played = label_plans(scenes, game, plan_to_steps(times, fps, "simulate"), fps)
    for index, search in enumerate(searches):
        own = game == index
        if own.any():
            search.played.append(Outcomes(*(column[own] for column in vars(played).values())))


def _dataset(scenes: Sequence[Scene], searches: list[_Search], settings: dict[str, Any]) -> Dataset:
    """Cut each search where the official loop stops."""
    slots = scenes[0].limits.blocks
    kept = [np.sort(np.concatenate([search.rows(True), search.rows(False)])) for search in searches]
    parts = list(zip(searches, kept, strict=True))
    times = np.concatenate([np.zeros((0, slots)), *(np.array(s.times).reshape(-1, slots)[rows] for s, rows in parts)])
    entries = [_entry(scene, search) for scene, search in zip(scenes, searches, strict=True)]
    return Dataset(
        scenes=tuple(scenes),
        game=np.repeat(np.arange(len(scenes), dtype=np.int32), [len(rows) for rows in kept]),
        times=np.where(times == 0, np.nan, times).astype(np.float32),
        steps=plan_to_steps(times, settings["fps"], "simulate").astype(np.int16),
        success=np.concatenate([s.outcome("success")[rows] for s, rows in parts]),
        end_step=np.concatenate([s.outcome("end_step")[rows] for s, rows in parts]).astype(np.int16),
        removals=np.concatenate([s.outcome("removals")[rows] for s, rows in parts]).astype(np.int8),
        draw=np.concatenate(kept).astype(np.int32),
        poses=None,
        manifest={
            "schema": SCHEMA,
            "version": VERSION,
            **settings,
            "scenes": entries,
            "provenance": provenance(),
        },
    )


def _entry(scene: Scene, search: _Search) -> dict[str, Any]:
    """Return what a manifest says of a scene; `iterations` is where the official loop stops, null if it goes on."""
    rows = [search.rows(solved) for solved in (True, False)]
    complete = all(len(found) == wanted for found, wanted in zip(rows, search.wanted, strict=True))
    waits = [int(found[-1]) + 1 if len(found) else 0 for found in rows]
    made = max(waits) if complete else len(search.times)
    return {
        **scene_entry(scene),
        "iterations": made if complete else None,
        "draws": made,
        "solved": int(search.outcome("success")[:made].sum()),
        "faults": int((search.outcome("fault")[:made] != 0).sum()),
        "successes": len(rows[0]),
        "failures": len(rows[1]),
        "wait_successes": waits[0],
        "wait_failures": waits[1],
    }
