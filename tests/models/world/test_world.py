"""World models: what is exact is exact, training resumes to the same bits, and files are verified."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.attempts.agents import unrepeated
from iphyre_jax.cli.world import PlanInModel
from iphyre_jax.models.settings import settings_of
from iphyre_jax.models.storage import METRICS
from iphyre_jax.models.world import plays, runs, storage
from iphyre_jax.models.world.imagine import WorldImagination, WorldPlanner
from iphyre_jax.models.world.interface import (
    falls_until_contact,
    memory_after,
    moves_on,
    nothing_moves,
    predictor,
    roll,
    start_memory,
    start_rows,
)
from iphyre_jax.models.world.networks import mdrnn, objects
from iphyre_jax.models.world.reports.metrics import horizon_errors
from iphyre_jax.models.world.rows import centres, rows_of, state_in
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import scene_tables, state_of
from iphyre_jax.models.world.training import taken
from iphyre_jax.observations.official import object_rows, scene_features
from iphyre_jax.rules import GOAL_Y
from iphyre_jax.scenes import load_scene
from tests.models.world.made_up import falling
from tests.other_options import other_options

QUIET = Console(quiet=True)
MDRNN = WorldConfig(model="mdrnn", data="100", steps=4, chunk=2, batch_size=2, sequence=3)
OBJECTS = WorldConfig(width=8, latent=2, parts=1, passes=1, neighbours=2, batch_size=2, steps=2, chunk=1, unroll=1)
PLAYS = falling(3)
PARAMS = jax.jit(objects.init, static_argnums=0)(OBJECTS, jax.random.key(0))


@pytest.mark.slow
def test_rows_are_the_official_ones_and_give_the_state_back() -> None:
    scene = load_scene("pendulum")
    tables = scene_tables([scene])
    rows = start_rows(taken(tables, jnp.zeros(1, jnp.int32)))
    features = scene_features(scene)
    official = object_rows(features, features.position, np.zeros(12), features.present)
    official[:, 7:] = np.minimum(official[:, 7:], 1)
    np.testing.assert_allclose(rows[0, :, :9], official, atol=1e-3)
    _, state = state_in(taken(tables, jnp.zeros(1, jnp.int32)), rows)
    np.testing.assert_allclose(state.centre[0, 0], features.position[6], atol=1e-4)
    np.testing.assert_allclose(state.velocity[0, 0], [0, 100 / 60], atol=1e-4)
    assert tables.tie[0, 0, 0] == 1
    assert tables.rest[0, 0, 0] == pytest.approx(np.linalg.norm(features.position[6] - features.position[5]))


def test_removals_fall_on_instants() -> None:
    # Removed before physics step 7: at instant 1, which begins after step 7 - 6 * 1 = 1. Before step 18: one later.
    assert plays.instants(np.array([0, 1, 2, 7, 13, 18, -1])).tolist() == [0, 0, 1, 1, 2, 3, plays.STAYS]


@pytest.mark.slow
def test_free_fall_is_exact_before_training() -> None:
    index = np.array([[0, 0], [1, 3], [2, 10]], np.int32)
    errors = horizon_errors(predictor(OBJECTS, 2), PARAMS, OBJECTS, falling(3, 80), index)
    assert errors.shape == (5, 3, 1)
    assert errors[:4].max() < 0.05  # 3 s in float32
    fallen_out = np.array([[0, 60]], np.int32)
    assert np.isnan(horizon_errors(predictor(OBJECTS, 2), PARAMS, OBJECTS, falling(3, 80), fallen_out)).all()
    still = horizon_errors(nothing_moves, (), None, falling(3, 80), index)
    assert still[0, 0, 0] == pytest.approx(np.hypot(0.7, 0.1 * 100 / 60 + 15 * 100 / 3600), rel=1e-3)
    assert horizon_errors(falls_until_contact, (), None, falling(3, 80), index)[3].max() < 0.05
    # Gravity adds 100 px/s^2 x (0.1 s)^2 = 1 px to each way; at the start nothing is known of a way before.
    steadily = horizon_errors(moves_on, (), None, falling(3, 80), index)[:3, :, 0]
    np.testing.assert_allclose(steadily[:, 1:], np.repeat([[1], [15], [55]], 2, axis=1), atol=0.02)
    np.testing.assert_allclose(steadily[:, 0], still[:3, 0, 0], atol=1e-4)


@pytest.mark.slow
def test_a_model_that_remembers_has_seen_what_came_before() -> None:
    """The memory at instant 2 of a play is that of two predictions from what was there, removal and all."""
    found = falling(2, 20)
    params = jax.jit(mdrnn.init, static_argnums=0)(MDRNN, jax.random.key(0))
    scene = taken(found.scenes, jnp.asarray(found.scene))
    recorded, gone = jnp.asarray(found.state), jnp.asarray(found.gone).at[:, 0].set(1)
    predict, start = jax.jit(predictor(MDRNN)), start_memory(MDRNN, scene)
    config = dataclasses.replace(MDRNN, sequence=6)
    after, last = (
        memory_after(predictor(MDRNN), params, start, recorded, gone, jnp.array([0, 2]), steps) for steps in (3, 1)
    )
    by_hand = start
    for k in range(2):
        rows = rows_of(scene, state_of(recorded[:, k]), gone >= k)
        if k == 1:
            only = predict(params, start, rows, gone == k)[1]
            np.testing.assert_allclose(last.recurrent[0][1], only.recurrent[0][1], atol=1e-6)
        _, by_hand = predict(params, by_hand, rows, gone == k)
    for seen, empty, stepped in zip(after.recurrent, start.recurrent, by_hand.recurrent, strict=True):
        np.testing.assert_array_equal(seen[0], empty[0])
        np.testing.assert_allclose(seen[1], stepped[1], atol=1e-6)
        assert float(jnp.abs(seen[1]).max()) > 0
    other = memory_after(predictor(MDRNN), params, start, recorded, jnp.asarray(found.gone), jnp.array([0, 2]), 3)
    assert float(jnp.abs(other.recurrent[0][1] - after.recurrent[0][1]).max()) > 0
    now, later = rows_of(scene, state_of(recorded[:, 2]), gone >= 2), recorded[1, 3, 0, :2]
    errors = []
    for memory in (after, start):
        tables = roll(predictor(MDRNN), params, memory, now, gone - 2, 1, jnp.asarray)  # (1, 2, 12, 12)
        errors.append(float(jnp.linalg.norm(centres(tables)[0, 1, 2] - later)))
    judged = horizon_errors(predictor(MDRNN), params, config, found._replace(gone=np.asarray(gone)), np.array([[1, 2]]))
    assert judged[0, 0, 0] == pytest.approx(errors[0], rel=1e-4)
    assert abs(errors[0] - errors[1]) > 1e-3
    kept = memory_after(predictor(OBJECTS), PARAMS, start_memory(OBJECTS, scene), recorded, gone, jnp.array([0, 2]), 3)
    assert kept.recurrent == ()


@pytest.mark.slow
def test_a_removed_block_is_gone_and_a_block_that_stays_is_felt() -> None:
    scene = taken(PLAYS.scenes, jnp.zeros(2, jnp.int32))
    state = state_of(jnp.asarray(PLAYS.state)[jnp.array([0, 0]), 0])
    state = state._replace(centre=scene.centre[:, :1] - jnp.array([[[0.0, 28.0]]]))  # it touches the first block
    rows = rows_of(scene, state, jnp.ones((2, 12), bool))
    removal = jnp.zeros((2, 12), bool).at[1, :2].set(True)
    predict = jax.jit(predictor(OBJECTS, 2))  # one program, not one for each operation
    after, _ = predict(PARAMS, start_memory(OBJECTS, scene), rows, removal)
    assert float(jnp.abs(after[1, :2]).max()) == 0
    assert float(jnp.abs(after[0, :2] - rows[0, :2]).max()) == 0  # static blocks stay
    assert float(jnp.abs(after[0, 2] - after[1, 2]).max()) > 1e-6


@pytest.mark.slow
def test_sigma_is_bounded_and_finite() -> None:
    scene = taken(PLAYS.scenes, jnp.zeros(3, jnp.int32))
    state = state_of(jnp.asarray(PLAYS.state)[:, 0])
    wild = jax.tree.map(lambda leaf: leaf * 10, PARAMS)
    step = jax.jit(objects.step, static_argnums=(0, 5))
    _, sigma = step(OBJECTS, wild, scene, state, jnp.ones((3, 12), bool), 2)
    for spread, (low, high) in zip(sigma, objects.BOUNDS, strict=True):
        assert np.isfinite(spread).all()
        assert low * 0.999 <= float(spread.min()) <= float(spread.max()) <= high * 1.001


@pytest.mark.slow
def test_resumes_to_the_same_bits_whatever_the_options_of_jax_and_refuses_other_settings(tmp_path: Path) -> None:
    whole = runs.train(tmp_path / "whole", MDRNN, QUIET, PLAYS)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patched:
        kept = storage.save
        patched.setattr(storage, "save", lambda *given: (kept(*given), interrupt()))
        with pytest.raises(KeyboardInterrupt):
            runs.train(tmp_path / "cut", MDRNN, QUIET, PLAYS)
    with other_options():
        resumed = runs.train(tmp_path / "cut", MDRNN, QUIET, PLAYS)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.isfinite(one).all()
    assert (tmp_path / "cut" / METRICS).read_bytes() == (tmp_path / "whole" / METRICS).read_bytes()
    with pytest.raises(ValueError, match=r"config\.json: settings: expected those of this run"):
        runs.train(tmp_path / "cut", dataclasses.replace(MDRNN, seed=1), QUIET, PLAYS)


@pytest.mark.slow
def test_objects_learns_and_ships(tmp_path: Path) -> None:
    state = runs.train(tmp_path / "run", OBJECTS, QUIET, PLAYS)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
    model = storage.trained_model(tmp_path / "run")
    assert model.origin["steps"] == OBJECTS.steps
    assert model.origin["trained"]["machine"]
    storage.FILES.save(tmp_path, dataclasses.replace(model, name="one"))
    loaded = storage.load_model("one", tmp_path)
    for one, other in zip(jax.tree.leaves(model.params), jax.tree.leaves(loaded.params), strict=True):
        np.testing.assert_array_equal(one, other)
    (tmp_path / "one.npz").write_bytes((tmp_path / "one.npz").read_bytes()[:-1])
    with pytest.raises(ValueError, match="damaged"):
        storage.load_model("one", tmp_path)


@pytest.mark.slow
def test_imagination_keeps_the_rules() -> None:
    """With the bound that stops at the first contact: "support" is solved once both blocks are gone."""
    model = storage.WorldModel("objects", OBJECTS, PARAMS, {})
    imagination = WorldImagination(model, falls_until_contact)
    with other_options():
        found = imagination.imagined("support", [[0.1, 0.1], [np.nan, np.nan]])
    assert found.success.tolist() == [True, False]
    assert found.eliminations.tolist() == [2, 0]
    assert found.steps[1] == 900
    assert found.reward[0] == pytest.approx(1000 - 20 - found.steps[0] / 60)
    assert found.reward[1] == pytest.approx(-15)
    agent = WorldPlanner(imagination, 20)
    plans = agent(load_scene("support"), 3, np.random.default_rng(0), ())
    assert plans.shape == (3, 2)
    assert unrepeated(plans).all()


@pytest.mark.parametrize(("predictions", "success", "step"), [(1, True, 7), (149, True, 895), (150, False, 900)])
def test_imagination_ends_with_the_episode(predictions: int, success: bool, step: int) -> None:
    """The 150th prediction would be of the world after step 901."""
    ball = load_scene("support").balls[0]
    fall = (GOAL_Y - float(ball[1]) + 0.1) / predictions  # px in each 0.1 s

    def falls(params: object, memory: Any, rows: jax.Array, gone: jax.Array) -> tuple[jax.Array, Any]:
        return rows.at[:, :, np.array([1, 3])].add(fall), memory

    found = WorldImagination(storage.WorldModel("objects", OBJECTS, PARAMS, {}), falls).imagined(
        "support", [[np.nan, np.nan]]
    )
    assert (found.success.tolist(), found.steps.tolist()) == ([success], [step])


def test_mdrnn_sees_lengths_scaled_and_flags_whole() -> None:
    rows = jnp.zeros((1, 12, 12)).at[0, 0, :9].set(jnp.array([60.0, 120.0, 180.0, 120.0, 10.0, 1.0, 0.0, 1.0, 0.0]))
    table = mdrnn.scaled(rows)
    assert table[0, :9].tolist() == pytest.approx([0.1, 0.2, 0.3, 0.2, 1 / 60, 1, 0, 1, 0])
    removal = jnp.zeros((1, 12), bool).at[0, 0].set(True)
    assert mdrnn.action_of(rows, removal)[0].tolist() == pytest.approx([0.2, 0.2])
    assert mdrnn.action_of(rows, ~removal & removal)[0].tolist() == [0, 0]


@pytest.mark.parametrize(("field", "value"), [("parts", 4), ("steps", 3), ("model", "gpt"), ("noise_px", -1.0)])
def test_wrong_settings_are_refused(field: str, value: object) -> None:
    content = {**WorldConfig(steps=4, chunk=2).to_json(), field: value}
    with pytest.raises(ValueError, match=rf"file: settings: ({field}|chunk): expected"):
        settings_of(WorldConfig, content, "file")


def test_the_command_plans_in_what_ships() -> None:
    assert PlanInModel("seesaw").model in storage.names()


@pytest.mark.parametrize("name", storage.names())
def test_what_ships_loads(name: str) -> None:
    assert (storage.WEIGHTS / f"{name}.npz").stat().st_size < 300_000
    model = storage.load_model(name)
    assert model.config.row == name
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(model.params))
