"""The games of one set of parameters on the host, and how worlds that play them are cut into groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.host_observations import HostObservations
from iphyre_jax.envs.batching.step_program import EnvStep, scene_layout
from iphyre_jax.execution.batching import lane_slices

Ints = npt.NDArray[np.signedinteger[Any]]
Floats = npt.NDArray[np.float32]
Selection = npt.NDArray[np.intp] | slice


@dataclass(frozen=True, eq=False)
class Group:
    """Worlds of one topology that run side by side in one call."""

    number: int  # among the groups of its topology
    topology_id: int
    rows: Selection
    games: Ints  # of the worlds, sorted


class GameTable:
    """Packed scenes, and each game's episode and observation before its first step.

    Args:
        key: identifies the scenes and their topologies.
        scenes: (games, words), see `scene_layout`.
        topology_id: (games,) index into the programs.
        programs: one for each topology.
        observations: of these games.
    """

    def __init__(
        self, key: bytes, scenes: Ints, topology_id: Ints, programs: Sequence[EnvStep], observations: HostObservations
    ) -> None:
        self.key, self.topology_id, self.observations = key, topology_id, observations
        self._programs = programs
        present = np.unique(topology_id).tolist()
        self._topology_ids = sorted(present, key=lambda one: -programs[one].topology.moving)  # the costliest first
        # The place of each game in the order by topology; small integers sort fastest.
        self._sort_key = np.empty(len(topology_id), np.uint16 if len(topology_id) < 2**16 else np.int64)
        self._sort_key[np.argsort(topology_id, kind="stable")] = np.arange(len(topology_id))
        layouts = [scene_layout(program.topology, program.dtype) for program in programs]
        self.scenes = [np.ascontiguousarray(scenes[:, : layout.rows]) for layout in layouts]
        self.start_words: Ints = np.zeros(0, scenes.dtype)  # (games, words), set by `HostStep`
        self.start_obs: Floats = np.zeros(0, np.float32)  # (games, D)

    def groups(self, game: Ints) -> list[Group]:
        """Sort worlds by topology and game, and cut them into groups; game: (B,) of each world."""
        if len(self.topology_id) == 1:
            return self._cut(self._topology_ids[0], None, game)
        order = np.argsort(self._sort_key[game], kind="stable")
        games = game[order]
        counts = np.bincount(self.topology_id[games], minlength=len(self._programs))
        ends = np.cumsum(counts)
        groups = []
        for topology_id in self._topology_ids:
            part = slice(ends[topology_id] - counts[topology_id], ends[topology_id])
            groups += self._cut(topology_id, order[part], games[part])
        return groups

    def _cut(self, topology_id: int, rows: npt.NDArray[np.intp] | None, games: Ints) -> list[Group]:
        """Cut the worlds of one topology into groups; rows: None for all worlds as they stand."""
        parts = enumerate(lane_slices(len(games), self._programs[topology_id].lanes))
        return [Group(k, topology_id, part if rows is None else rows[part], games[part]) for k, part in parts]
