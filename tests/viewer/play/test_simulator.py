"""Plays of the page: bounded in time, memory and queues, whatever the scene; others play on meanwhile."""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from iphyre_jax import load_scene
from iphyre_jax.execution.own_process import EndedError
from iphyre_jax.scenes import Scene, scene_from_dict
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.play.process import PlayProcess
from iphyre_jax.viewer.play.simulator import Simulator, SimulatorLimits, _Place
from iphyre_jax.viewer.play.worker import ARRAYS, RESULTS
from iphyre_jax.viewer.plays import Play
from iphyre_jax.viewer.recording import record

HOLE = Play("you", load_scene("hole"), (-1, -1, 83, 32))


def heavy_scene(bars: int = 49, balls: int = 15, springs: int = 105) -> Scene:
    """Return a valid scene; by default it takes many minutes to compile."""
    left = [(10 + k % 10 * 58, 200 + k // 10 * 60) for k in range(bars)]
    pairs = list(itertools.combinations(range(bars, bars + balls), 2))
    return scene_from_dict(
        {
            "schema": "iphyre_jax/scene",
            "version": 1,
            "name": "heavy",
            "block": [[[x, y], [x + 40, y]] for x, y in left],
            "ball": [[30 + 38 * k, 100, 10] for k in range(balls)],
            "eli": [0] * (bars + balls),
            "dynamic": [0] * bars + [1] * balls,
            "spring": [list(pair) for pair in pairs[:springs]],
            "limits": {"objects": 64, "blocks": 9},  # of no other test, so that nobody else compiles its program
        }
    )


class FakeProcess:
    """A process that does what it is told."""

    number, runs = 1, True

    def __init__(self, act: Callable[[], dict[str, Any]]) -> None:
        self._act = act

    def ask(self, request: object, seconds: float) -> dict[str, Any]:
        return self._act()

    def end(self) -> None:
        self.runs = False


def place(act: Callable[[], dict[str, Any]], **limits: Any) -> tuple[_Place, list[FakeProcess]]:
    """Return a place whose processes all do this, and the processes that it has made."""
    made: list[FakeProcess] = []

    def make() -> Any:
        made.append(FakeProcess(act))
        return made[-1]

    return _Place(make, 1.0, SimulatorLimits(**limits)), made


def test_only_a_few_wait_and_others_are_refused_at_once() -> None:
    begun, go_on = Event(), Event()

    def play() -> dict[str, Any]:
        begun.set()
        assert go_on.wait(30)
        return {}

    one, _ = place(play, waiting=2)
    with ThreadPoolExecutor(3) as pool:
        waiting = [pool.submit(one.ask, {})]
        assert begun.wait(30)
        waiting += [pool.submit(one.ask, {}) for _ in range(2)]
        while one._free._value:  # type: ignore[attr-defined]  # until they wait
            time.sleep(0.01)
        with pytest.raises(RefusedError, match="the simulator is busy") as caught:
            one.ask({})
        assert caught.value.status == 503
        go_on.set()
        assert [future.result(30) for future in waiting] == [{}] * 3
    assert one.ask({}) == {}


def test_nobody_waits_for_ever() -> None:
    begun, go_on = Event(), Event()
    one, _ = place(lambda: {"x": begun.set() or go_on.wait(30)}, patience=0.1)
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(one.ask, {})
        assert begun.wait(30)
        with pytest.raises(RefusedError, match="the simulator is busy"):
            one.ask({})
        go_on.set()
        assert first.result(30)


def test_a_process_that_has_ended_is_replaced_once() -> None:
    answers: list[dict[str, Any] | Exception] = [{}, EndedError("idle"), {}, EndedError("a"), EndedError("b"), {}]

    def act() -> dict[str, Any]:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    one, made = place(act)
    assert [one.ask({}), one.ask({})] == [{}, {}]
    assert len(made) == 2
    with pytest.raises(RefusedError, match="its simulator ended, perhaps for lack of memory"):
        one.ask({})
    assert one.ask({}) == {}
    assert [process.runs for process in made] == [False] * (len(made) - 1) + [True]


def test_a_process_that_has_grown_is_replaced() -> None:
    one, made = place(lambda: {"memory": 100}, kept=99)
    one.ask({})
    one.ask({})
    assert [process.runs for process in made] == [False, False]


def test_what_the_process_says_is_an_error_for_the_player() -> None:
    with pytest.raises(ValueError, match="plan: wrong"):
        place(lambda: {"error": "plan: wrong", "is_mistake": True})[0].ask({})
    with pytest.raises(RefusedError, match="the simulator failed: MemoryError: "):
        place(lambda: {"error": "MemoryError: ", "is_mistake": False})[0].ask({})


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    simulator = Simulator(SimulatorLimits(drawn_seconds=4.0, idle=600.0))
    yield simulator
    simulator.close()


def children(process: int) -> list[int]:
    """Return the processes that a process has started."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text("utf-8").rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process and fields[0] != "Z":
            found.append(int(folder.name))
    return found


@pytest.mark.slow  # starts processes
@pytest.mark.parametrize("idle", [0.3, None])
def test_a_process_ends_when_it_is_idle_or_alone(idle: float | None, capfd: pytest.CaptureFixture[str]) -> None:
    process = PlayProcess({"memory": 0, "niceness": 0, "idle": idle}, {})
    if idle is None:
        assert process._process._process.stdin is not None
        process._process._process.stdin.close()  # as when the server is killed
    assert process._process._process.wait(60) == 0
    assert not process.runs
    process.end()
    assert capfd.readouterr().err == ""


@pytest.mark.slow  # starts processes
def test_a_play_has_the_bits_of_a_recording(simulator: Simulator) -> None:
    ours, theirs = record(HOLE.scene, HOLE.plan), simulator.record(HOLE, is_game=True)
    for name in (*ARRAYS, *RESULTS, "plan", "fps", "dtype", "resets"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    (process,) = simulator.processes[:1]
    os.kill(process, signal.SIGKILL)
    assert simulator.record(HOLE, is_game=True).reward == ours.reward
    assert process not in simulator.processes
    with pytest.raises(ValueError, match="resets: expected"):
        simulator.record(Play("you", HOLE.scene, HOLE.plan, resets=0), is_game=True)


@pytest.mark.slow  # starts processes
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_heavy_scene_is_ended_and_others_play_on(simulator: Simulator) -> None:
    simulator.record(HOLE, is_game=True)
    heavy = Play("you", heavy_scene(), ())
    with ThreadPoolExecutor(1) as pool:
        refused = pool.submit(simulator.record, heavy, is_game=False)
        busy: set[int] = set()
        plays = 0
        while not refused.done():
            begin = time.monotonic()
            assert simulator.record(HOLE, is_game=True).success
            assert time.monotonic() - begin < 2.0
            plays += 1
            busy |= {child for process in simulator.processes[1:] for child in (process, *children(process))}
        with pytest.raises(RefusedError, match="this scene is too large to be played here") as caught:
            refused.result()
    assert caught.value.status == 422
    assert plays > 3
    assert len(busy) >= 2  # it was compiling, in a process of its own
    end = time.monotonic() + 20
    while any(Path(f"/proc/{process}").exists() for process in busy):
        assert time.monotonic() < end, "a process of the heavy scene is still there"
        time.sleep(0.05)
    begin = time.monotonic()
    with pytest.raises(RefusedError, match="this scene is too large"):
        simulator.record(heavy, is_game=False)
    assert time.monotonic() - begin < 1.0


@pytest.mark.slow  # starts processes
def test_a_scene_that_needs_too_much_memory_ends_clearly() -> None:
    pytest.importorskip("resource")
    simulator = Simulator(SimulatorLimits(memory=1 << 29, drawn_seconds=300.0))
    try:
        with pytest.raises(RefusedError, match="its simulator ended, perhaps for lack of memory"):
            simulator.record(Play("you", heavy_scene(1, 1, 0), ()), is_game=False)
        assert simulator.record(HOLE, is_game=True).success
    finally:
        simulator.close()
