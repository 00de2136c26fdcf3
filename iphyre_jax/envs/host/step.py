"""One decision of many worlds on the host, in NumPy and executables."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import jax
import numpy as np

from iphyre_jax.envs.batching.status import FAULT, STEP, SUCCESS, status_words
from iphyre_jax.envs.host.game_table import Floats, GameTable, Ints, ProgramCall
from iphyre_jax.envs.host.observations import HostObservations
from iphyre_jax.envs.host.packed_scenes import PackedScenes
from iphyre_jax.envs.host.step_program import GROUPS, RESET, EnvStep
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.execution import configuration, interrupts
from iphyre_jax.execution.compilation.client import ClientArray, aligned
from iphyre_jax.execution.compilation.executables import executable, prepare
from iphyre_jax.execution.layout import Layout, pieces
from iphyre_jax.execution.programs import pack_timing
from iphyre_jax.execution.threads import run_all
from iphyre_jax.observations.features import Features
from iphyre_jax.scenes.compile import step_timing

ID_WORDS: Final = 2  # words in front of a packed scene that identify its content
SHORT: Final = 1.2e-3  # s; a decision that takes less gains nothing from a second thread, which must be woken
TABLES_CACHED: Final = 16  # sets of scenes


class HostStep:
    """Plays batches of worlds of some topologies, on all threads that `configure` allows.

    Args:
        programs: one for each topology, alike otherwise.
        protocol: of the episodes.
        features: layout of `Features` in the words of a scene.
        make_observations: returns the `HostObservations` of games with given features.
    """

    def __init__(
        self,
        programs: Sequence[EnvStep],
        protocol: EpisodeProtocol,
        features: Layout,
        make_observations: Callable[[Features], HostObservations],
    ) -> None:
        self.programs = tuple(programs)
        self.slots = programs[0].slots
        self.status_words = status_words(self.slots)
        self.episode_words = max(program.episode_words for program in programs) + 1  # the last: id of the scene
        self._body_obs_size = max(program.body_obs_size for program in programs)
        self._features, self._make_observations = features, make_observations
        self._steps = protocol.steps
        self._groups = [ClientArray(np.array([groups], np.int32)) for groups in range(GROUPS + 1)]
        self._timing = ClientArray(pack_timing(step_timing(protocol.fps, programs[0].dtype)))
        self._packed = PackedScenes()
        self._tables: OrderedDict[bytes, GameTable] = OrderedDict()
        self._seconds = 0.0  # processor time of the calls of the last decision
        self._lock = threading.Lock()
        self._local = threading.local()

    def prepare(self) -> None:
        """Compile and load the programs."""
        prepare(self.programs)

    def reset(self, scenes: Ints, topology_id: Ints, game: Ints) -> tuple[Ints, Floats]:
        """Return episodes of games before their first step, (B, words), and their observations."""
        table = self._table(scenes, topology_id)
        words = table.start_words[game]
        words[:, 0] = game
        return words, table.start_obs[game]

    def step(
        self,
        scenes: Ints,
        topology_id: Ints,
        episodes: Ints,
        requests: Ints,
        next_game: Ints,
        out: tuple[Ints, Floats, Ints, Ints],
        final: tuple[Ints, Floats] | None,
    ) -> None:
        """Play one decision of each episode; an episode that ends is followed by the next.

        Args:
            scenes: (games, words), see `HostParams`.
            topology_id: (games,).
            episodes: (B, words), each begun with the scene that its game has here.
            requests: (B, words), see `EnvStep.request_words`, of the words' dtype.
            next_game: (B,) game of the episode that follows; -1 for none.
            out: receives the episodes (B, words), perhaps in place, their observations, and the packed status before
                the decision and after it, before any reset.
            final: receives the episodes and observations before any reset, if given.

        Raises:
            ValueError: an episode was begun with another scene; one line.
        """
        table, (words, obs, before, status) = self._table(scenes, topology_id), out
        others = episodes[:, -1] != table.start_words[episodes[:, 0], -1]
        if others.any():
            row = int(episodes[others.argmax(), 0])
            raise ValueError(
                f"state: expected one of these parameters, got another scene at row {row}; reset all worlds after a "
                "change of parameters"
            )
        before[:] = episodes[:, : self.status_words]
        steps = int((requests[:, self.slots] - episodes[:, STEP]).max())
        threads = 1 if self._seconds < SHORT else configuration.threads()
        calls = table.calls(episodes[:, 0], steps, threads)
        body_obs = np.zeros((len(words), self._body_obs_size), np.float32)
        self._run_all(partial(self._run, table, episodes, requests, (words, body_obs)), calls, threads)
        status[:] = words[:, : self.status_words]
        words[:, -1] = episodes[:, -1]
        table.observations.write(obs, status, body_obs, self._steps)
        if final is not None:
            final[0][:], final[1][:] = words, obs
        done = (status[:, SUCCESS] != 0) | (status[:, FAULT] != 0) | (status[:, STEP] >= self._steps)
        ended = np.flatnonzero(done & (next_game >= 0))
        if ended.size:
            games = next_game[ended]
            words[ended], obs[ended] = table.start_words[games], table.start_obs[games]
            words[ended, 0] = games

    def _run_all(self, work: Callable[[ProgramCall], None], calls: Sequence[ProgramCall], threads: int) -> None:
        """Make calls, on all threads or here, and take their time."""

        def timed(call: ProgramCall) -> float:
            interrupts.check()
            start = time.thread_time()
            work(call)
            return time.thread_time() - start

        self._seconds = sum(run_all(timed, calls) if threads > 1 else map(timed, calls))

    def _table(self, scenes: Ints, topology_id: Ints) -> GameTable:
        key = scenes[:, :ID_WORDS].tobytes() + topology_id.tobytes()
        with self._lock:
            if key in self._tables:
                self._tables.move_to_end(key)
                return self._tables[key]
        scenes, topology_id = np.array(scenes), np.array(topology_id)  # copies: the buffers belong to the caller
        features = self._features.unpack_numpy(scenes[:, ID_WORDS : ID_WORDS + self._features.rows].T)
        features = jax.tree.map(lambda leaf: np.moveaxis(leaf, -1, 0), features)
        own = scenes[:, ID_WORDS + self._features.rows :]
        table = GameTable(key, own, topology_id, self.programs, self._make_observations(features))
        self._set_starts(table, scenes)
        with self._lock:
            self._tables[key] = table
            while len(self._tables) > TABLES_CACHED:
                self._tables.popitem(last=False)
        return table

    def _set_starts(self, table: GameTable, scenes: Ints) -> None:
        """Compute each game's episode and observation before its first step; scenes: (games, words)."""
        games = np.arange(len(table.topology_id))
        requests = np.full((len(games), self.programs[0].request_words), -1, table.scenes[0].dtype)
        requests[:, self.slots], requests[:, self.slots + 1 :] = RESET, 0
        episodes = np.zeros((len(games), self.episode_words), table.scenes[0].dtype)
        episodes[:, 0] = games
        body_obs = np.zeros((len(games), self._body_obs_size), np.float32)
        words, obs = np.zeros_like(episodes), np.zeros((len(games), table.observations.size), np.float32)
        for call in table.calls(games, 0, 1):
            self._run(table, episodes, requests, (words, body_obs), call)
        table.observations.write(obs, words[:, : self.status_words], body_obs, self._steps)
        words[:, -1] = scenes[:, 0]
        table.start_words, table.start_obs = words, obs

    def _run(
        self, table: GameTable, episodes: Ints, requests: Ints, out: tuple[Ints, Floats], call: ProgramCall
    ) -> None:
        """Play one decision of the worlds of a call; `out` receives episodes and observations of moving bodies."""
        program, count, rows = self.programs[call.topology_id], len(call.games), call.rows
        width = program.episode_words
        worlds = self._scratch(call.topology_id)
        pieces(worlds, 0, width)[:count] = pieces(episodes, 0, width)[rows]
        pieces(worlds, width, program.request_words)[:count] = pieces(requests, 0, program.request_words)[rows]
        spare = worlds[count : call.groups * program.lanes]  # they repeat the last world and wait
        spare[:], spare[:, width + self.slots] = worlds[count - 1], worlds[count - 1, STEP]
        with self._packed.of(table, call, program) as scenes:
            after = executable(program)(scenes, worlds, self._timing, self._groups[call.groups])[0]
        pieces(out[0], 0, width)[rows] = pieces(after, 0, width)[:count]
        if width < self.episode_words - 1:
            out[0][rows, width:-1] = 0
        if after.itemsize == 4:
            pieces(out[1], 0, program.body_obs_size)[rows] = pieces(after, width, program.body_obs_size)[:count]
        else:
            out[1][rows, : program.body_obs_size] = after[:count, width:].astype(np.int32).view(np.float32)

    def _scratch(self, topology_id: int) -> Ints:
        """Return this thread's array of worlds for calls of a program."""
        arrays: dict[int, Ints] = self._local.__dict__.setdefault("arrays", {})
        if topology_id not in arrays:
            shape = self.programs[topology_id].arguments()[1]
            arrays[topology_id] = aligned(shape.shape, shape.dtype)
        return arrays[topology_id]
