"""Packed scenes of the lanes of calls, kept from decision to decision."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from iphyre_jax.envs.host.game_table import GameTable, Ints, ProgramCall
from iphyre_jax.envs.host.step_program import EnvStep
from iphyre_jax.execution.compilation.client import aligned
from iphyre_jax.execution.layout import fill_lanes

CALLS_KEPT: Final = 128  # some hundred kilobytes each; the least recently used goes first


class PackedScenes:
    """Packed scenes as programs take them; only lanes whose game has changed are written again."""

    def __init__(self) -> None:
        # By table, topology and number of the call: the game of each lane, and the scenes.
        self._kept: OrderedDict[tuple[bytes, int, int], tuple[Ints, Ints]] = OrderedDict()
        self._lock = threading.Lock()

    @contextmanager
    def of(self, table: GameTable, call: ProgramCall, program: EnvStep) -> Iterator[Ints]:
        """Yield the scenes of a call, see `EnvStep`; spare lanes repeat the last world's. They change afterwards."""
        key = table.key, call.topology_id, call.number
        # Nobody else has them meanwhile: another thread that makes the same call begins with none.
        with self._lock:
            kept = self._kept.pop(key, None)
        games, scenes = _room(program) if kept is None else kept
        wanted = fill_lanes(call.games, call.groups * program.lanes)
        changed = np.flatnonzero(games[: len(wanted)] != wanted)
        games[changed] = wanted[changed]
        scenes[changed // program.lanes, :, changed % program.lanes] = table.scenes[call.topology_id][wanted[changed]]
        yield scenes
        with self._lock:
            self._kept[key] = games, scenes
            if len(self._kept) > CALLS_KEPT:
                self._kept.popitem(last=False)


def _room(program: EnvStep) -> tuple[Ints, Ints]:
    """Return lanes without games, and room for their scenes."""
    scenes = program.arguments()[0]
    return np.full(program.most_worlds, -1), aligned(scenes.shape, scenes.dtype)
