"""A scene of 15 objects and 8 eliminable blocks: reading, limits, play as in the reference, drawing, environments."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.cli.main import run
from iphyre_jax.compat import IPHYRE
from iphyre_jax.envs.in_advance import observation_table
from iphyre_jax.observations.drawing import BALL, ELIMINABLE
from iphyre_jax.observations.official import start_observation
from iphyre_jax.physics.collision.contact_table import STATIC_BODY
from iphyre_jax.physics.order_keys import STATIC_RANKS, OrderKeyLayout
from iphyre_jax.scenes import (
    Limits,
    Scene,
    SceneBuilder,
    load_scene,
    load_scenes,
    read_scene,
    scene_from_dict,
    scene_to_dict,
    vary,
    write_scene,
)
from iphyre_jax.scenes.limits import MAX_MOVING, MOST_OBJECTS, OFFICIAL
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.viewer.plays import SCHEMA, VERSION, play_from_json
from parity.engines.reference import run as run_reference
from parity.play import Task, compare_scenes

LARGE = Limits(objects=16, blocks=9)


@cache
def large() -> Scene:
    """Return a stair of eight removable blocks, six fixed blocks and one ball: one moving body compiles fast."""
    builder = SceneBuilder("stair", LARGE)
    for k in range(8):
        builder.block((40 + 60 * k, 200 + 40 * k), (80 + 60 * k, 200 + 40 * k), eliminable=True)
    for k in range(5):
        builder.block((100 + 80 * k, 560), (130 + 80 * k, 560 - 20 * (k % 2)))
    builder.block((210, 150), (330, 155))
    builder.ball((60, 100))
    return builder.build()


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("large") / "stair.json"
    write_scene(large(), path)
    return path


def test_limits_are_what_the_solver_can_hold() -> None:
    assert MAX_MOVING == STATIC_BODY  # the moving bodies are 0 .. 14
    assert MOST_OBJECTS <= STATIC_RANKS  # one is a ball, which moves
    assert OrderKeyLayout(MAX_MOVING).max_steps >= 15 * 60
    for numbers in ((11, 6), (12, 5), (65, 6), (20, 65), (20.0, 6), (True, 6)):
        with pytest.raises(ValueError, match=r"limits: (objects|blocks): expected a whole number from") as caught:
            Limits(*numbers)  # type: ignore[arg-type]
        assert "\n" not in str(caught.value)


def test_a_file_states_its_limits(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert read_scene(path) == large()
    assert large().limits == LARGE == vary(large(), 1, jitter_px=0.5).scenes[0].limits
    assert load_scene(path, Limits(20, 8)).limits == Limits(20, 8)
    assert load_scene("hole", LARGE) != load_scene("hole") == load_scene(load_scene("hole", LARGE), OFFICIAL)
    assert "limits" not in scene_to_dict(load_scene("hole"))
    silent = {key: value for key, value in json.loads(path.read_text()).items() if key != "limits"}
    path.with_name("silent.json").write_text(json.dumps(silent))
    assert run(["scene", "check", str(path.with_name("silent.json"))]) == 2
    assert "silent.json: block: expected at most 12 entries, got a list of 14" in capsys.readouterr().err
    options = ["--max-objects", "15", "--max-blocks", "8"]
    assert run(["scene", "check", *options, str(path.with_name("silent.json"))]) == 0
    assert "valid, stair: 14 blocks (8 eliminable, 0 moving)" in capsys.readouterr().out
    assert run(["scene", "check", *options[:3], "7", str(path)]) == 2
    assert "stair.json: eli: expected at most 7 eliminable blocks, got 8" in capsys.readouterr().err
    assert run(["scene", "check", "--max-objects", "99", str(path)]) == 2
    assert "limits: objects: expected a whole number from 12 to 64, got 99" in capsys.readouterr().err


def _with(**changes: Any) -> dict[str, Any]:
    return scene_to_dict(large()) | changes


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "too many objects": (
        _with(limits={"objects": 14, "blocks": 8}),
        "file: block: expected at most 14 objects, got 14 blocks and 1 balls",
    ),
    "too many blocks": (
        _with(limits={"objects": 15}),
        "file: eli: expected at most 6 eliminable blocks, got 8",
    ),
    "too many that move": (
        _with(
            block=[],
            ball=[[100, 10 * k, 5] for k in range(16)],
            eli=[0] * 16,
            dynamic=[1] * 16,
        ),
        "file: dynamic: expected at most 15 objects that move, got 16",
    ),
    "limits a list": (
        _with(limits=[15, 8]),
        'file: limits: expected an object {"objects": ..., "blocks": ...}, got a list of 2',
    ),
    "limits of another name": (
        _with(limits={"balls": 3}),
        'file: limits: expected an object {"objects": ..., "blocks": ...}, got an object of 1 fields',
    ),
    "limits too large": (
        _with(limits={"objects": 1000}),
        "file: limits: objects: expected a whole number from 12 to 64, got 1000",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_exceeds_limits_is_told_in_one_line(case: str) -> None:
    data, message = WRONG[case]
    with pytest.raises(ValueError) as caught:
        scene_from_dict(data, "file")
    assert str(caught.value).split("\n")[0] == message


def test_a_large_scene_is_simulated_as_the_reference_does() -> None:
    task = Task((large(),), plans=12, rates=(10,), dtypes=("float64",), resets=2, seed=0, duration=5.0)
    compared = compare_scenes(task)[0].comparison
    assert compared.identical.all()
    assert (compared.steps == compared.reference_steps).all()
    assert len(set(compared.steps.tolist())) >= 3  # some plans solve it


def _actions(strategy: str, frames: np.ndarray) -> np.ndarray:
    """Return the actions that remove the block of slot s in frame s + 1 and no other block."""
    if strategy == "on-the-fly":
        return np.append([0], np.arange(1, frames.size + 1))
    return np.tile(frames / 150, (1 if strategy == "in-advance" else frames.size + 1, 1)).astype(np.float32)


@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly", "combined"])
def test_a_large_scene_is_decided_on(strategy: str) -> None:
    name = f"{strategy}-stair-v1"
    iphyre_jax.register(name, [large()])
    env, params = iphyre_jax.make(f"{strategy}/{name}", autoreset=False)
    slots, rows = LARGE.blocks, LARGE.objects * 9
    state = env.reset(jax.random.key(0), params)[1]
    actions = _actions(strategy, np.arange(1, slots + 1))
    for action in actions:
        seen, state, _, _, _, info = env.step(jax.random.key(0), state, jnp.asarray(action), params)
    assert env.observation_space().contains(np.asarray(seen))
    assert env.action_space().contains(actions[0].astype(env.action_space().dtype))
    assert int(info["eliminations"]) == 8
    assert not np.asarray(seen)[: 8 * 9].any()
    assert np.asarray(seen)[8 * 9 : rows].any()
    while not (info["success"] or info["time"] > 14.95):  # on the fly there is more to decide
        seen, state, _, _, _, info = env.step(jax.random.key(0), state, jnp.asarray(actions[0]), params)
    plan = np.arange(1, 9, dtype=np.int32)
    reference = run_reference(large(), plan, fps=10, steps=150, resets=2)
    assert (bool(info["success"]), round(float(info["time"]) * 10)) == (reference.success, reference.steps)


def test_agents_are_made_for_official_limits(path: Path) -> None:
    with pytest.raises(ValueError, match=r"^games: expected scenes without limits of their own.* got .*stair\.json'$"):
        TrainConfig(games=(str(path),)).check()


@pytest.mark.slow
def test_a_large_scene_is_seen_and_drawn(path: Path) -> None:
    seen = start_observation(large())
    assert seen.shape == (16 * 9 + 9 * 2,)
    assert seen[-18:].reshape(9, 2).any(axis=1).tolist() == [True] * 8 + [False]
    simulator = IPHYRE(path)
    assert len(simulator.get_action_space()) == 10
    assert simulator.get_all_property().shape == (16, 9)
    seen = simulator.picture()
    assert all((seen[200 + 40 * k, 60 + 60 * k] == ELIMINABLE).all() for k in range(8))
    assert (seen[110, 55] == BALL).all()


def test_a_play_of_a_large_scene_is_read() -> None:
    told = {
        "schema": SCHEMA,
        "version": VERSION,
        "agent": "me",
        "scene": scene_to_dict(large()),
        "plan": [-1] * 7 + [3],
    }
    assert play_from_json(told, "line 1").scene == large()


def test_limits_of_an_environment_are_the_largest_of_its_scenes() -> None:
    observations = {
        limits: iphyre_jax.make("on-the-fly/hole-v1", limits=limits)[0].observation_space().shape
        for limits in (None, LARGE)
    }
    assert observations == {None: (122,), LARGE: (16 * 9 + 2 + 18,)}
    scenes = load_scenes([load_scene("hole"), large()])
    assert {scene.limits for scene in scenes} == {LARGE}
    assert observation_table(["hole", large()]).shape == (2, 16 * 9 + 18)
    with pytest.raises(ValueError, match=r"^Scene 'stair': blocks: expected at most 12 entries, got a list of 14$"):
        iphyre_jax.evaluate(lambda key, seen: seen[:6], [large()], strategy="in-advance", limits=OFFICIAL)
