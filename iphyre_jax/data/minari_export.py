"""Data sets as Minari data sets.

Without sequences an episode is one decision, in advance: the observation of the start, then that of the end of the
episode, which is the same; the action has the times in seconds, 0 for a block that stays. It always ends by itself:
it is terminated, solved or not. With sequences it has a
decision every 0.1 s: tables before each, and flags of the blocks that go before the next one. Rewards are the paper's:
their sum is the reward of the play.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.adapters.minari_writer import Episode, write_minari
from iphyre_jax.checks import check_instance
from iphyre_jax.data.dataset import Dataset
from iphyre_jax.data.official_files import drawn_times
from iphyre_jax.data.sequences import tables
from iphyre_jax.observations.official import start_observation
from iphyre_jax.rules import DECISIONS_PER_SECOND, ELIMINATION_REWARD, SECOND_REWARD, SUCCESS_REWARD, TIME_LIMIT

PART: Final = 256  # plays whose tables are in memory at a time


def export_minari(dataset: Dataset, dataset_id: str) -> Any:  # noqa: ANN401
    """Write a data set as a new Minari data set, where Minari keeps them (MINARI_DATASETS_PATH).

    Args:
        dataset: with sequences or without.
        dataset_id: as Minari names data sets: "iphyre/official-v0".

    Returns:
        The `minari.MinariDataset`. The infos of an episode have `game` (index), `steps` (what was played), `end_step`
        and `draw`, the same at each decision.

    Raises:
        ModuleNotFoundError: minari is missing; one line that names the extra.
        ValueError: Minari refuses the name or has a data set of this name, or there are no plays; one line.
    """
    check_instance("dataset", dataset, Dataset, "a Dataset, as load_dataset returns it")
    games = ", ".join(scene.name for scene in dataset.scenes[:50])
    about = f"I-PHYRE plays at {dataset.fps} steps a second; games by index: {games}"
    if dataset.poses is None:
        return write_minari(dataset_id, _decisions(dataset), TIME_LIMIT, about)
    return write_minari(dataset_id, _sequences(dataset), None, about)


def _infos(dataset: Dataset, row: int, count: int) -> dict[str, npt.NDArray[Any]]:
    of_play: dict[str, npt.NDArray[Any]] = {
        "game": dataset.game,
        "steps": dataset.steps,
        "end_step": dataset.end_step,
        "draw": dataset.draw,
    }
    return {name: np.repeat(column[row : row + 1], count, axis=0) for name, column in of_play.items()}


def _decisions(dataset: Dataset) -> Iterator[Episode]:
    """Yield one episode of one decision for each play."""
    starts = [start_observation(scene) for scene in dataset.scenes]
    times = drawn_times(dataset).astype(np.float32)
    for row, game in enumerate(dataset.game.tolist()):
        reward = SUCCESS_REWARD * dataset.success[row] + ELIMINATION_REWARD * dataset.removals[row]
        reward += SECOND_REWARD * dataset.end_step[row] / dataset.fps
        yield Episode(
            observations=np.stack([starts[game]] * 2),
            actions=times[row : row + 1],
            rewards=np.array([reward], np.float64),
            terminated=True,  # as of `adapters.endings`
            seed=row,
            infos=_infos(dataset, row, 2),
        )


def _sequences(dataset: Dataset) -> Iterator[Episode]:
    """Yield one episode of a decision every 0.1 s for each play."""
    for first in range(0, len(dataset), PART):
        part = dataset.select(np.arange(first, min(first + PART, len(dataset))))
        seen_before = tables(part, official=False).astype(np.float32)
        for row in range(len(part)):
            yield _sequence(part, row, seen_before[row], first + row)


def _sequence(dataset: Dataset, row: int, rows: npt.NDArray[np.float32], number: int) -> Episode:
    every, end, steps = dataset.fps // DECISIONS_PER_SECOND, int(dataset.end_step[row]), dataset.steps[row].astype(int)
    count = min(-(-end // every), len(rows))
    starts = np.arange(count) * every
    ends = np.append(starts[1:], end)
    actions = (steps >= starts[:, None]) & (steps < ends[:, None])
    rewards = SECOND_REWARD * (ends - starts) / dataset.fps + ELIMINATION_REWARD * actions.sum(axis=1)
    rewards[-1] += SUCCESS_REWARD * dataset.success[row]
    last = rows[min(count, len(rows) - 1)]  # after 15 s the table of the last frame stands for the end
    return Episode(
        observations=np.concatenate([rows[:count], last[None]]),
        actions=actions.astype(np.int8),
        rewards=rewards,
        terminated=bool(dataset.success[row]),
        seed=number,
        infos=_infos(dataset, row, count + 1),
    )
