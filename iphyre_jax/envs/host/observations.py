"""Observations of many worlds, assembled by the host.

Most of an observation never changes: the rows of objects that do not move depend on the game and on the blocks that are
present. They are cached for every set of present blocks that occurs. An observation is a copy of such a row, with the
moving bodies, as the executables return them, written over it. `observations.vectors.observe` gives the same numbers
inside a program.
"""

from __future__ import annotations

import threading
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.status import FAULT, GAME, PRESENT, STEP
from iphyre_jax.envs.host.step_program import BODY_OBS
from iphyre_jax.execution.layout import FLAGS, flag_words, pieces, void
from iphyre_jax.observations.features import Features, motion_size, rows_size
from iphyre_jax.observations.official import COLUMNS, JOINT_COLUMN, LENGTH_COLUMNS, SPRING_COLUMN, pair_number
from iphyre_jax.observations.vectors import ObservationName, observation_size
from iphyre_jax.rollouts import FAULT_NOT_FINITE

CACHED: Final = 65_536  # rows; half a kilobyte each
MOST_NUMBERS: Final = 2**22  # of rows by game and set, 8 bytes each; one call may need more

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.signedinteger[Any]]
Sets = npt.NDArray[np.uint64]


class HostObservations:
    """Observations of the games of one table.

    Args:
        features: of the games, NumPy arrays with an axis for the games in front.
        observation: "motion" adds velocities and time.
        no_op: whether a candidate that does nothing stands before those of the blocks.
    """

    def __init__(self, features: Features, observation: ObservationName, *, no_op: bool) -> None:
        self._features, self._motion, self._no_op = features, observation == "motion", no_op
        games, objects = np.shape(features.obs_rows)[:2]
        slots = np.shape(features.slot_object)[1]
        self.size = observation_size(observation, objects, slots + no_op)
        self._rows = rows_size(objects)
        self._mover = np.asarray(features.mover)
        self._powers = np.left_shift(np.uint64(1), np.arange(slots, dtype=np.uint64))
        self._lock = threading.Lock()
        # Sets of present blocks so far, as bits, sorted; the row of each game and set, -1 for none; the rows. Rows are
        # there before their numbers are, whatever ends a call in between.
        self._empty = np.zeros(0, np.uint64), np.zeros((games, 0), np.intp), np.zeros((0, self.size), np.float32)
        self._cache = self._empty

    def write(self, out: Floats, status: Ints, body_obs: Floats, steps: int) -> None:
        """Write observations.

        Args:
            out: (B, size), contiguous.
            status: (B, words), see `status_rows`.
            body_obs: (B, 7 n), see `EnvStep`; padded.
            steps: physics steps of a whole episode, the unit of the time.
        """
        game, step, fault = status[:, GAME], status[:, STEP], status[:, FAULT]
        with self._lock:
            ids, cached = self._find(game, self._sets(status[:, PRESENT:]))
        pieces(out, 0, self.size)[:] = pieces(cached, 0, self.size)[ids]
        broken = np.flatnonzero(fault == FAULT_NOT_FINITE)
        out[broken, : self._rows] = 0
        start = np.arange(len(out)) * self.size
        for body in range(self._mover.shape[1]):
            mover = self._mover[game, body]
            rows = None if (mover >= 0).all() else np.flatnonzero(mover >= 0)
            self._write_body(out, start, mover, rows, body_obs, BODY_OBS * body)
        if self._motion:
            out[:, -1] = step.astype(np.float32) * (1 / np.float32(steps))
            out[broken, -1] = 0

    def _write_body(
        self, out: Floats, start: Ints, mover: Ints, rows: Ints | None, body_obs: Floats, column: int
    ) -> None:
        """Write ends and speeds of one moving body of each world, or of the worlds `rows` only."""
        parts = [(4, COLUMNS, 0, column)]
        if self._motion:
            parts.append((3, 3, self.size - motion_size(self._rows // COLUMNS), column + 4))
        for width, stride, first, source in parts:
            where = start + (first + stride * mover)
            what = _windows(body_obs, width)[source :: body_obs.shape[1]]
            if rows is None:
                _windows(out, width)[where] = what
            else:
                _windows(out, width)[where[rows]] = what[rows]

    def _sets(self, words: Ints) -> Sets:
        """Return sets of present blocks as bits; words: (B, words), from the first of the set on."""
        sets = np.zeros(len(words), np.uint64)
        for word in range(flag_words(len(self._powers))):
            bits = (words[:, word].astype(np.int64) & (2**FLAGS - 1)).astype(np.uint64)
            sets |= bits << np.uint64(FLAGS * word)
        return sets

    def _find(self, game: Ints, masks: Sets) -> tuple[npt.NDArray[np.intp], Floats]:
        """Return the row of each world in the cached rows, and these; missing ones are made.

        masks: (B,), see `_sets`.
        """
        known, table, rows = self._cache
        column = np.searchsorted(known, masks)
        if not len(known) or (known[np.minimum(column, len(known) - 1)] != masks).any():
            every = np.union1d(known, masks)
            if len(known) and len(table) * len(every) > MOST_NUMBERS:
                self._cache = self._empty
                return self._find(game, masks)
            wider = np.full((len(table), len(every)), -1, np.intp)
            wider[:, np.searchsorted(every, known)] = table
            known, table, column = every, wider, np.searchsorted(every, masks)
            self._cache = known, table, rows
        ids = table[game, column]
        if ids.size and ids.min() < 0:
            missing = np.unique(np.stack([game, column])[:, ids < 0], axis=1)
            if len(rows) and len(rows) + missing.shape[1] > CACHED:
                self._cache = self._empty
                return self._find(game, masks)
            made = [self._row(one, (known[mask] & self._powers) != 0) for one, mask in missing.T.tolist()]
            numbers, rows = len(rows) + np.arange(len(made)), np.concatenate([rows, np.stack(made)])
            self._cache = known, table, rows
            table[tuple(missing)] = numbers
            ids = table[game, column]
        return ids, rows

    def _row(self, game: int, present_slots: npt.NDArray[np.bool_]) -> Floats:
        """Return the observation of a game with some blocks present, before moving bodies are written over it."""
        features = self._features
        table = np.array(features.obs_rows[game], np.float32)
        present = table[:, LENGTH_COLUMNS - 1] > 0  # the radius
        for block, is_present in zip(np.asarray(features.slot_object)[game], present_slots, strict=True):
            if block >= 0 and not is_present:
                present[block] = False
        for column, pairs in ((JOINT_COLUMN, features.joints), (SPRING_COLUMN, features.springs)):
            table[:, column] = pair_number(np.asarray(pairs)[game], present) > 0
        table[~present] = 0
        row = np.zeros(self.size, np.float32)
        row[: self._rows] = table.reshape(-1)
        first = self._rows + 2 * self._no_op
        candidates = np.asarray(features.candidates)[game].reshape(-1)
        row[first : first + len(candidates)] = candidates
        return row


def _windows(table: Floats, width: int) -> npt.NDArray[np.void]:
    """Return every run of so many numbers of a contiguous table as a single value; the runs overlap."""
    return np.ndarray((table.size - width + 1,), void(width * table.itemsize), table, 0, (table.itemsize,))
