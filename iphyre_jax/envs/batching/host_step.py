"""Episodes of many worlds, played by the host in NumPy and executables: one decision of all of them at a time."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.host_observations import HostObservations
from iphyre_jax.envs.batching.status import FAULT, STEP, SUCCESS, status_words
from iphyre_jax.envs.batching.step_program import RESET, EnvStep, scene_layout
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.execution.compilation.client import ClientArray, aligned, aligned_copy
from iphyre_jax.execution.compilation.executables import executable, prepare
from iphyre_jax.execution.layout import Layout, filled, pieces
from iphyre_jax.execution.programs import pack_timing
from iphyre_jax.execution.threads import run_all
from iphyre_jax.observations.features import Features
from iphyre_jax.scenes.compile import step_timing

ID_WORDS: Final = 2  # in front of a scene's words: tells its content from any other
SHORT: Final = 1e-3  # s, of a task; shorter ones gain nothing from a second thread, which must be woken
TABLES_KEPT: Final = 16  # sets of scenes
LAID_OUT_KEPT: Final = 64  # scenes of tasks, some hundred kilobytes each

Ints = npt.NDArray[np.signedinteger[Any]]
Selection = npt.NDArray[np.intp] | slice


@dataclass(frozen=True, eq=False)
class _Task:
    """Worlds of one topology that one call plays."""

    number: int  # among the tasks of its kind
    topology_id: int
    rows: Selection
    games: Ints  # of the worlds, sorted


class _Table:
    """A set of scenes: sorted, cut to their own words, what is seen of them, and as they begin."""

    def __init__(
        self, key: bytes, scenes: Ints, topology_id: Ints, programs: Sequence[EnvStep], observations: HostObservations
    ) -> None:
        self.key, self.topology_id, self.observations = key, topology_id, observations
        self.topology_ids = np.unique(topology_id).tolist()
        sort_key = np.empty(len(topology_id), np.uint16 if len(topology_id) < 2**16 else np.int64)
        sort_key[np.argsort(topology_id, kind="stable")] = np.arange(len(topology_id))
        self.sort_key = sort_key  # place of each game among all, sorted by topology
        layouts = [scene_layout(program.topology, program.dtype) for program in programs]
        self.scenes = [np.ascontiguousarray(scenes[:, : layout.rows]) for layout in layouts]
        self.words: Ints = np.zeros(0, scenes.dtype)  # (games, words) of each game before its first step
        self.obs: npt.NDArray[Any] = np.zeros(0)  # what is seen of it


class HostStep:
    """Plays batches of worlds of some topologies, on all threads that `configure` allows.

    Args:
        programs: one for each topology, the same but for that.
        protocol: timing of the episodes.
        features: layout of `Features` in the words of a scene.
        view: makes the `HostObservations` of a table from its features.
    """

    def __init__(
        self,
        programs: Sequence[EnvStep],
        protocol: EpisodeProtocol,
        features: Layout,
        view: Callable[[Features], HostObservations],
    ) -> None:
        self.programs = tuple(programs)
        self.slots = programs[0].slots
        self.status = status_words(self.slots)
        self.episode_words = max(program.episode_words for program in programs)
        self._body_obs_size = max(program.body_obs_size for program in programs)
        self._features, self._view = features, view
        self._steps = protocol.steps
        self._once = ClientArray(np.ones(1, np.int32))
        self._timing = ClientArray(pack_timing(step_timing(protocol.fps, programs[0].dtype)))
        self._tables: OrderedDict[bytes, _Table] = OrderedDict()
        self._laid_out: OrderedDict[tuple[bytes, int, int], tuple[Ints, Ints, ClientArray]] = OrderedDict()
        self._task_seconds = 0.0  # processor time of a task, the mean of the last decision's
        self._lock = threading.Lock()
        self._local = threading.local()

    def prepare(self) -> None:
        """Compile and load what is needed."""
        prepare(self.programs)

    def reset(self, scenes: Ints, topology_id: Ints, game: Ints) -> tuple[Ints, npt.NDArray[Any]]:
        """Return episodes of games before their first step, (B, words), and what is seen of them."""
        table = self._table(scenes, topology_id)
        words = table.words[game]
        words[:, 0] = game
        return words, table.obs[game]

    def step(
        self,
        scenes: Ints,
        topology_id: Ints,
        episodes: Ints,
        requests: Ints,
        next_game: Ints,
        out: tuple[Ints, npt.NDArray[Any], Ints],
        final: tuple[Ints, npt.NDArray[Any]] | None,
    ) -> None:
        """Play episodes on, and begin the next ones of those that end.

        Args:
            scenes: (games, words) as of `host_worlds`.
            topology_id: (games,) topology of each.
            episodes: (B, words).
            requests: (B, 2 slots + 1) as of `EnvStep`, of the words' dtype.
            next_game: (B,) game that follows an episode; -1 for none.
            out: is filled with episodes (B, words), what is seen of them, and the packed status of those played.
            final: is filled with the episodes played as they are then, and what is seen of them.
        """
        table, (words, obs, status) = self._table(scenes, topology_id), out
        tasks = self._tasks(table, episodes[:, 0])
        body_obs = np.zeros((len(words), self._body_obs_size), np.float32)
        self._run_tasks(partial(self._run, table, episodes, requests, (words, body_obs)), tasks)
        status[:] = words[:, : self.status]
        table.observations.write(obs, status, body_obs, self._steps)
        if final is not None:
            final[0][:], final[1][:] = words, obs
        done = (status[:, SUCCESS] != 0) | (status[:, FAULT] != 0) | (status[:, STEP] >= self._steps)
        ended = np.flatnonzero(done & (next_game >= 0))
        if ended.size:
            games = next_game[ended]
            words[ended], obs[ended] = table.words[games], table.obs[games]
            words[ended, 0] = games

    def _run_tasks(self, work: Callable[[_Task], None], tasks: Sequence[_Task]) -> None:
        """Run tasks: long ones on all threads, short ones here, for waking a thread takes longer than they do."""

        def timed(task: _Task) -> float:
            began = time.thread_time()
            work(task)
            return time.thread_time() - began

        are_short = self._task_seconds < SHORT or len(tasks) == 1
        seconds = [timed(task) for task in tasks] if are_short else run_all(timed, tasks)
        self._task_seconds = sum(seconds) / len(seconds)

    def _table(self, scenes: Ints, topology_id: Ints) -> _Table:
        key = scenes[:, :ID_WORDS].tobytes() + topology_id.tobytes()
        with self._lock:
            if key in self._tables:
                self._tables.move_to_end(key)
                return self._tables[key]
        scenes, topology_id = (
            np.array(scenes),
            np.array(topology_id),
        )  # what is kept must not lie in the caller's buffers
        features = self._features.unpack_numpy(scenes[:, ID_WORDS : ID_WORDS + self._features.rows].T)
        features = jax.tree.map(lambda leaf: np.moveaxis(leaf, -1, 0), features)
        own = scenes[:, ID_WORDS + self._features.rows :]
        table = _Table(key, own, topology_id, self.programs, self._view(features))
        self._set_starts(table)
        with self._lock:
            self._tables[key] = table
            while len(self._tables) > TABLES_KEPT:
                self._tables.popitem(last=False)
        return table

    def _set_starts(self, table: _Table) -> None:
        """Find out how each game begins."""
        games = np.arange(len(table.topology_id))
        requests = np.full((len(games), 2 * self.slots + 1), -1, table.scenes[0].dtype)
        requests[:, self.slots], requests[:, self.slots + 1 :] = RESET, 0
        episodes = np.zeros((len(games), self.episode_words), table.scenes[0].dtype)
        episodes[:, 0] = games
        body_obs = np.zeros((len(games), self._body_obs_size), np.float32)
        words, obs = np.zeros_like(episodes), np.zeros((len(games), table.observations.size), np.float32)
        for task in self._tasks(table, games):
            self._run(table, episodes, requests, (words, body_obs), task)
        table.observations.write(obs, words[:, : self.status], body_obs, self._steps)
        table.words, table.obs = words, obs

    def _tasks(self, table: _Table, game: Ints) -> list[_Task]:
        """Sort worlds by topology and game, and cut them into tasks; those of most moving bodies come first."""
        if len(table.topology_id) == 1:
            return self._cut(table.topology_ids[0], None, game)
        order = np.argsort(table.sort_key[game], kind="stable")
        games = game[order]
        counts = np.bincount(table.topology_id[games], minlength=len(self.programs))
        ends = np.cumsum(counts)
        tasks = []
        for topology_id in sorted(
            table.topology_ids, key=lambda topology_id: -self.programs[topology_id].topology.moving
        ):
            if counts[topology_id]:
                part = slice(ends[topology_id] - counts[topology_id], ends[topology_id])
                tasks += self._cut(topology_id, order[part], games[part])
        return tasks

    def _cut(self, topology_id: int, rows: npt.NDArray[np.intp] | None, games: Ints) -> list[_Task]:
        """Cut the worlds of one topology into tasks."""
        lanes, count = self.programs[topology_id].lanes, len(games)
        parts = [slice(start, min(start + lanes, count)) for start in range(0, count, lanes)]
        return [
            _Task(number, topology_id, part if rows is None else rows[part], games[part])
            for number, part in enumerate(parts)
        ]

    def _run(
        self, table: _Table, episodes: Ints, requests: Ints, out: tuple[Ints, npt.NDArray[Any]], task: _Task
    ) -> None:
        """Play the worlds of one task."""
        program, count = self.programs[task.topology_id], len(task.games)
        row, width = program.episode_words, self.episode_words
        worlds = self._scratch(task.topology_id)
        pieces(worlds, 0, row)[:count] = pieces(episodes, 0, row)[task.rows]
        pieces(worlds, row, program.request_words)[:count] = pieces(requests, 0, program.request_words)[task.rows]
        if count < program.lanes:  # spare lanes repeat the last world and wait
            worlds[count:] = worlds[count - 1]
            worlds[count:, row + self.slots] = worlds[count - 1, STEP]
        after = executable(program)(self._scenes(table, task), worlds, self._timing, self._once)[0]
        pieces(out[0], 0, row)[task.rows] = pieces(after, 0, row)[:count]
        if row < width:
            out[0][task.rows, row:] = 0
        if after.itemsize == 4:
            pieces(out[1], 0, program.body_obs_size)[task.rows] = pieces(after, row, program.body_obs_size)[:count]
        else:
            out[1][task.rows, : program.body_obs_size] = after[:count, row:].astype(np.int32).view(np.float32)

    def _scratch(self, topology_id: int) -> Ints:
        """Return this thread's table of worlds for the calls of a program."""
        kept = self._local.__dict__.setdefault("tables", {})
        if topology_id not in kept:
            shape = self.programs[topology_id].arguments()[1]
            kept[topology_id] = aligned(shape.shape, shape.dtype)
        table: Ints = kept[topology_id]
        return table

    def _scenes(self, table: _Table, task: _Task) -> ClientArray:
        """Return the words of a task's scenes, (words, lanes), laid out before if they were wanted before."""
        lanes, words = self.programs[task.topology_id].lanes, table.scenes[task.topology_id]
        place, games = (table.key, task.topology_id, task.number), filled(task.games, lanes)
        with self._lock:
            there, laid, given = self._laid_out.get(place, (None, None, None))
        if there is None or laid is None or given is None or (there != games).any():
            # A new array, for another thread may be reading the old one.
            changed = np.arange(lanes) if there is None else np.flatnonzero(there != games)
            laid = aligned((words.shape[1], lanes), words.dtype) if laid is None else aligned_copy(laid)
            laid[:, changed] = words[games[changed]].T
            given = ClientArray(laid)
            self._keep(place, (games, laid, given))
        return given

    def _keep(self, place: tuple[bytes, int, int], laid_out: tuple[Ints, Ints, ClientArray]) -> None:
        with self._lock:
            self._laid_out[place] = laid_out
            while len(self._laid_out) > LAID_OUT_KEPT:
                self._laid_out.popitem(last=False)
