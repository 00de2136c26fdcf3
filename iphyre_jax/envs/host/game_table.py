"""The games of one set of parameters on the host, and the calls of programs for worlds that play them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.host.observations import HostObservations
from iphyre_jax.envs.host.step_program import GROUPS, EnvStep, scene_layout

STEPS_OF_A_CALL: Final = 48  # at most, all groups together; threads share out a longer decision

Ints = npt.NDArray[np.signedinteger[Any]]
Floats = npt.NDArray[np.float32]
Selection = npt.NDArray[np.intp] | slice


@dataclass(frozen=True, eq=False)
class ProgramCall:
    """Worlds of one topology that one call of its program plays."""

    number: int  # among the calls of its topology
    topology_id: int
    rows: Selection
    games: Ints  # of the worlds, sorted
    groups: int  # of lanes; the last one may have spare lanes


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

    def calls(self, game: Ints, steps: int, threads: int) -> list[ProgramCall]:
        """Sort worlds by topology and game, and share them out to calls.

        Args:
            game: (B,) of each world.
            steps: the most physics steps that a world makes.
            threads: that make the calls.
        """
        order = np.argsort(self._sort_key[game], kind="stable") if len(self.topology_id) > 1 else None
        games = game if order is None else game[order]
        counts = np.bincount(self.topology_id[games], minlength=len(self._programs)).tolist()
        groups = [-(-count // program.lanes) for count, program in zip(counts, self._programs, strict=True)]
        most = max(1, min(GROUPS, STEPS_OF_A_CALL // max(1, steps), sum(groups) // threads))
        calls = []
        for topology_id in self._topology_ids:
            start, count, lanes = sum(counts[:topology_id]), counts[topology_id], self._programs[topology_id].lanes
            for number, first in enumerate(range(0, groups[topology_id], most)):
                own = slice(start + first * lanes, start + min((first + most) * lanes, count))
                rows = own if order is None else order[own]
                calls.append(ProgramCall(number, topology_id, rows, games[own], min(most, groups[topology_id] - first)))
        return calls
