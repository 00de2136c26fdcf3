"""Plays for the page, in processes that can be ended: no scene takes more than its time and memory.

One process, *quick*, plays whatever is compiled, in milliseconds. What is not compiled goes to one of two others, which
end when they have been idle: *games*, for the scenes of the benchmark, and *drawn*, for all others. So a scene whose
compilation takes long keeps nobody from playing, and nobody's scene keeps a game from being compiled.

At each process only a few requests may wait; more are refused at once. A compilation that takes too long is ended, and
its program is refused for a while.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation.cache_folder import CACHE_VARIABLE
from iphyre_jax.execution.own_process import EndedError
from iphyre_jax.rules import NEVER
from iphyre_jax.scenes import scene_to_dict
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.play.process import PlayProcess
from iphyre_jax.viewer.plays import Play
from iphyre_jax.viewer.record_program import RecordProgram
from iphyre_jax.viewer.recording import Recording, record_program

GIGABYTE: Final = 1 << 30
REFUSED_KEPT: Final = 256  # programs that took too long


@dataclass(frozen=True)
class SimulatorLimits:
    """What the plays of the page may take.

    Attributes:
        play_seconds: s, of a play whose program is compiled.
        game_seconds: s, of the first play of a game, which compiles its program.
        drawn_seconds: s, the same for any other scene.
        refused_seconds: s, so long a program is refused that took longer than that.
        memory: bytes of address space of a process that compiles, and again of its compiler; 0 for no limit.
        kept: bytes of resident memory beyond which a process is replaced after its play.
        waiting: requests that may wait for each process, beside the one that it plays.
        patience: s, the longest wait.
        idle: s, after which a process that compiles ends.
    """

    play_seconds: float = 20.0
    game_seconds: float = 300.0
    drawn_seconds: float = 120.0
    refused_seconds: float = 120.0
    memory: int = 4 * GIGABYTE
    kept: int = GIGABYTE
    waiting: int = 4
    patience: float = 60.0
    idle: float = 30.0


class Simulator:
    """Plays for the page. Any number of threads may ask.

    Args:
        limits: of time, memory and queues.
    """

    def __init__(self, limits: SimulatorLimits | None = None) -> None:
        self.limits = limits = limits or SimulatorLimits()
        self._environment: dict[str, str] | None = None
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._lock = threading.Lock()
        self._refused: dict[RecordProgram, tuple[float, str]] = {}  # -> until when, in monotonic seconds, and why

        def process(**settings: object) -> PlayProcess:
            return PlayProcess({"memory": 0, "niceness": 0, "idle": None, **settings}, self._settings())

        def compiling() -> PlayProcess:
            return process(memory=limits.memory, niceness=5, idle=limits.idle)

        self._quick = _Place(process, limits.play_seconds, limits, stays=True)
        self._games = _Place(compiling, limits.game_seconds, limits)
        self._drawn = _Place(compiling, limits.drawn_seconds, limits)

    def record(self, play: Play, *, is_game: bool) -> Recording:
        """Play a plan and keep every frame, as `viewer.recording.record` does.

        Args:
            play: scene, plan and settings.
            is_game: whether the scene is one of the benchmark, whose compilations have a process of their own.

        Raises:
            RefusedError: too many wait, or the scene takes too much time or memory; one line for the player.
            ValueError: a setting is wrong; one line.
        """
        scene, settings = play.scene, {"fps": play.fps, "dtype": play.dtype, "resets": play.resets}
        program = record_program(scene, fps=play.fps, dtype=play.dtype)
        request = {"scene": scene_to_dict(scene), "plan": list(play.plan), **settings}
        with self._lock:
            until, reason = self._refused.get(program, (0.0, ""))
        if until > time.monotonic():
            raise RefusedError(422, reason)
        answer = self._quick.ask({**request, "compile": False})
        if "missing" in answer:
            place = self._games if is_game else self._drawn
            try:
                answer = place.ask({**request, "compile": True})
            except TooLargeError as error:
                self._refuse(program, str(error))
                raise
        plan = (*play.plan, *[NEVER] * (len(scene.eliminable_blocks) - len(play.plan)))
        return Recording(scene, plan, play.fps, play.dtype, play.resets, **answer["arrays"], **answer["result"])

    def warm_up(self) -> None:
        """Start the process for plays, in the background."""
        threading.Thread(target=self._quick.start, daemon=True).start()

    def close(self) -> None:
        """End all processes; they start again when they are needed."""
        for place in (self._quick, self._games, self._drawn):
            place.end()

    @property
    def processes(self) -> list[int]:
        """The numbers of the processes that run."""
        return [place.process.number for place in (self._quick, self._games, self._drawn) if place.process]

    def _settings(self) -> dict[str, str]:
        """Return variables of the processes' environment: the folder by which they share programs."""
        with self._lock:
            if self._environment is None:
                folder = configuration.cache_folder()
                if folder is None:
                    self._temporary = tempfile.TemporaryDirectory(prefix="iphyre_jax_play_")
                self._environment = {CACHE_VARIABLE: str(folder or (self._temporary and self._temporary.name))}
            return self._environment

    def _refuse(self, program: RecordProgram, reason: str) -> None:
        with self._lock:
            while len(self._refused) >= REFUSED_KEPT:
                del self._refused[next(iter(self._refused))]
            self._refused[program] = time.monotonic() + self.limits.refused_seconds, reason


_BUSY: Final = "the simulator is busy with other scenes; try again in a minute"


class TooLargeError(RefusedError):
    """A scene that takes more time or memory than it may."""

    def __init__(self, reason: str) -> None:
        super().__init__(422, f"this scene is too large to be played here: {reason}; {_REMEDY}")


_REMEDY: Final = "take away moving objects, joints or springs"


class _Place:
    """A process and the requests that wait for it. It starts when it is needed, and again after it has ended."""

    def __init__(
        self, make: Callable[[], PlayProcess], seconds: float, limits: SimulatorLimits, *, stays: bool = False
    ) -> None:
        self.process: PlayProcess | None = None
        self.seconds = seconds
        self._make, self._limits, self._stays = make, limits, stays
        self._turn, self._free = threading.Lock(), threading.BoundedSemaphore(1 + limits.waiting)

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Ask the process.

        Raises:
            RefusedError: too many wait.
            TooLargeError: the answer took too long, or the process ended without one.
            ValueError: the request is wrong; one line.
        """
        with self._turns():
            try:
                answer = self._ask_running(request)
            except TimeoutError:
                self._end()
                raise TooLargeError(f"preparing its simulator takes more than {self.seconds:g} s") from None
            if answer.get("memory", 0) > self._limits.kept:
                self._end()
                if self._stays:
                    threading.Thread(target=self.start, daemon=True).start()
        if error := answer.get("error"):
            raise ValueError(error) if answer["is_mistake"] else RefusedError(500, f"the simulator failed: {error}")
        return answer

    def _ask_running(self, request: dict[str, Any]) -> dict[str, Any]:
        """Ask the process; if it had been there before, it may have been idle or killed, so a new one is asked."""
        for was_there in (self.process is not None, False):
            try:
                return self._running().ask(request, self.seconds)
            except EndedError:
                self._end()
                if not was_there:
                    break
        raise TooLargeError("its simulator ended, perhaps for lack of memory")

    def start(self) -> None:
        """Start the process unless it runs."""
        with self._turn:
            self._running()

    def end(self) -> None:
        """End the process, also during a play."""
        if process := self.process:
            process.end()

    @contextmanager
    def _turns(self) -> Iterator[None]:
        """Wait for the process, if not too many others do."""
        if not self._free.acquire(blocking=False):
            raise RefusedError(503, _BUSY)
        try:
            if not self._turn.acquire(timeout=self._limits.patience):
                raise RefusedError(503, _BUSY)
            try:
                yield
            finally:
                self._turn.release()
        finally:
            self._free.release()

    def _running(self) -> PlayProcess:
        if self.process is None or not self.process.runs:
            self._end()
            self.process = self._make()
        return self.process

    def _end(self) -> None:
        if self.process is not None:
            self.process.end()
            self.process = None


@cache
def shared_simulator() -> Simulator:
    """Return the simulator of this process, so that its servers share programs and processes."""
    return Simulator()
