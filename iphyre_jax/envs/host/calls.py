"""The host callbacks of a program: buffers in and out, with the axes that `jax.vmap` has put in front."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.arguments import check_row
from iphyre_jax.envs.batching.status import GAME
from iphyre_jax.envs.host.step import HostStep
from iphyre_jax.execution.layout import Words


def reset_episodes(host: HostStep, _: object, out: Sequence[object], *given: object) -> None:
    """Reset episodes; arguments and results are buffers, each with the batch's axes, or axes of length 1, in front."""
    words, obs = _flat(out)
    batch = np.asarray(out[0]).shape[:-1]
    scenes, topology_id, first = _tables(given, batch)
    game: Words = np.broadcast_to(np.asarray(given[2]), batch).reshape(-1)
    words[:], obs[:] = host.reset(scenes, topology_id, game + first)
    words[:, 0] = game


def step_episodes(host: HostStep, _: object, out: Sequence[object], *given: object) -> None:
    """Play one decision of each episode; buffers as in `reset_episodes`. Episodes may be written where they are.

    Raises:
        ValueError: an episode is of a game that these tables do not have; one line.
    """
    words, obs, before, status, *final = _flat(out)
    batch = np.asarray(out[0]).shape[:-1]
    scenes, topology_id, first = _tables(given, batch)
    episodes, requests = (_as_rows(part, batch) for part in given[2:4])
    check_row(int(episodes[:, GAME].max()), np.asarray(given[1]).shape[-1])
    next_game = np.broadcast_to(np.asarray(given[4]), batch).reshape(-1)
    if np.ndim(first):  # each world has games of its own
        episodes = episodes.copy()
        episodes[:, 0] += first
        next_game = np.where(next_game < 0, next_game, next_game + first)
    last = (final[0], final[1]) if final else None
    host.step(scenes, topology_id, episodes, requests, next_game, (words, obs, before, status), last)
    if np.ndim(first):
        for rows in (words, before, status, *final[:1]):
            rows[:, 0] -= first


def _flat(buffers: Sequence[object]) -> list[npt.NDArray[Any]]:
    """Return buffers as arrays with one axis for the batch."""
    return [array.reshape(-1, array.shape[-1]) for array in map(np.asarray, buffers)]


def _as_rows(buffer: object, batch: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return a buffer of rows as a contiguous array with one axis for the batch, broadcast to it."""
    array = np.asarray(buffer)
    return np.ascontiguousarray(np.broadcast_to(array, (*batch, array.shape[-1]))).reshape(-1, array.shape[-1])


def _tables(given: Sequence[object], batch: tuple[int, ...]) -> tuple[Words, Words, int | npt.NDArray[np.intp]]:
    """Return scenes and topologies as one table, and the row of the first game of each world."""
    scenes, topology_id = np.asarray(given[0]), np.asarray(given[1])
    games, axes = topology_id.shape[-1], topology_id.shape[:-1]
    tables = scenes.reshape(-1, scenes.shape[-1]), topology_id.reshape(-1)
    if prod(axes) <= 1:
        return *tables, 0
    first = games * np.arange(prod(axes)).reshape(axes)
    return *tables, np.broadcast_to(first, batch).reshape(-1)
