"""How worlds are shared out to calls of programs, and the scenes that go into a call."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from iphyre_jax.envs.host import packed_scenes
from iphyre_jax.envs.host.game_table import STEPS_OF_A_CALL, GameTable, ProgramCall
from iphyre_jax.envs.host.packed_scenes import PackedScenes
from iphyre_jax.envs.host.step_program import GROUPS, EnvStep, scene_layout
from iphyre_jax.scenes import load_scene
from iphyre_jax.scenes.compile import topology_of

PROGRAMS = [EnvStep(topology_of(load_scene(game)), "float32", lanes, 6) for game, lanes in (("hole", 8), ("fill", 4))]
TOPOLOGY_ID = np.array([1, 0, 0, 1, 0])  # of five games


def table(key: bytes = b"") -> GameTable:
    words = max(scene_layout(program.topology, program.dtype).rows for program in PROGRAMS)
    scenes = np.arange(5, dtype=np.int32)[:, None] * 10_000 + np.arange(words, dtype=np.int32)
    return GameTable(key, scenes, TOPOLOGY_ID, PROGRAMS, cast(Any, None))


@pytest.mark.parametrize("threads", [1, 2, 64])
@pytest.mark.parametrize("steps", [0, 1, 6, 20, 900])
@pytest.mark.parametrize("worlds", [1, 3, 8, 200, 700])
def test_every_world_is_in_one_call(worlds: int, steps: int, threads: int) -> None:
    game = np.random.default_rng(worlds).integers(0, 5, worlds)
    calls = table().calls(game, steps, threads)
    rows = np.concatenate([call.rows for call in calls])
    assert sorted(rows.tolist()) == list(range(worlds))
    for call in calls:
        lanes = PROGRAMS[call.topology_id].lanes
        np.testing.assert_array_equal(call.games, game[call.rows])
        assert (TOPOLOGY_ID[call.games] == call.topology_id).all()
        assert (np.diff(call.games) >= 0).all()
        assert (call.groups - 1) * lanes < len(call.games) <= call.groups * lanes
        assert call.groups <= GROUPS
        assert call.groups == 1 or call.groups * steps <= STEPS_OF_A_CALL
    assert len({(call.topology_id, call.number) for call in calls}) == len(calls)
    groups = sum(call.groups for call in calls)
    assert len(calls) >= min(groups, threads)
    if steps <= STEPS_OF_A_CALL // GROUPS and threads == 1 and groups <= GROUPS:
        assert len(calls) <= len(PROGRAMS)


def assert_packed(scenes: np.ndarray[Any, Any], own: GameTable, call: ProgramCall) -> None:
    lanes = PROGRAMS[call.topology_id].lanes
    for lane in range(call.groups * lanes):
        game = call.games[min(lane, len(call.games) - 1)]  # spare lanes repeat the last world
        np.testing.assert_array_equal(scenes[lane // lanes, :, lane % lanes], own.scenes[call.topology_id][game])


def test_scenes_follow_the_games_of_their_lanes() -> None:
    packed, generator, tables = PackedScenes(), np.random.default_rng(0), (table(b"a"), table(b"b"))
    for turn in range(12):
        own = tables[turn % 2]
        for call in own.calls(generator.integers(0, 5, generator.integers(1, 150)), 1, 1):
            program = PROGRAMS[call.topology_id]
            with packed.of(own, call, program) as scenes:
                assert_packed(scenes, own, call)
                with packed.of(own, call, program) as others:  # as another thread would meanwhile
                    assert not np.shares_memory(scenes, others)
                    assert_packed(others, own, call)
            with packed.of(own, call, program) as again:
                assert again is scenes


def test_what_ends_a_call_drops_its_scenes() -> None:
    packed, own = PackedScenes(), table()
    first, then = (own.calls(np.array([game]), 1, 1)[0] for game in (1, 2))

    def interrupted() -> None:
        with packed.of(own, first, PROGRAMS[0]) as scenes:
            scenes[:] = -1
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    for call in (first, then, first):
        with packed.of(own, call, PROGRAMS[0]) as scenes:
            assert_packed(scenes, own, call)


def test_few_calls_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packed_scenes, "CALLS_KEPT", 3)
    packed = PackedScenes()
    for key in (b"a", b"b", b"c", b"d", b"e"):
        own = table(key)
        call = own.calls(np.array([1]), 1, 1)[0]
        with packed.of(own, call, PROGRAMS[0]) as scenes:
            assert_packed(scenes, own, call)
    assert [key[0] for key in packed._kept] == [b"c", b"d", b"e"]
