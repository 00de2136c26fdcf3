"""Networks: the paper's sizes and first values; what ours may and may not depend on."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.models.outcome.networks import ranker, relations
from iphyre_jax.models.outcome.networks.fusion import CLASSES, TorchDense, network
from iphyre_jax.models.outcome.plays import inputs
from iphyre_jax.models.outcome.settings import NetworkName, settings
from iphyre_jax.models.outcome.training import mirror_rows
from tests.models.outcome.made_up import made_up


@pytest.mark.parametrize(("name", "count"), [("global", 31_746), ("object", 2_306), ("plan", 3_842)])
def test_parameters_of_the_paper(name: NetworkName, count: int) -> None:
    plays, config = made_up(1, 0), settings("paper", name)
    scenes, seen = inputs.scene_inputs(plays.scenes, config), inputs.examples(plays, config)
    shapes = jax.eval_shape(
        lambda: network(config).init(jax.random.key(0), scenes.rows[plays.game], seen.plans, scenes, plays.game)
    )
    assert sum(leaf.size for leaf in jax.tree.leaves(shapes)) == count


def test_first_values_are_those_of_pytorch() -> None:
    params = TorchDense(4096).init(jax.random.key(0), jnp.zeros((1, 16)))["params"]
    for values in map(np.asarray, params.values()):
        assert np.abs(values).max() <= 0.25  # 1 / sqrt(16)
        assert np.abs(values).max() > 0.249
        assert values.std() == pytest.approx(0.25 / np.sqrt(3), rel=0.03)
        assert abs(values.mean()) < 0.01


def test_all_balls_must_come_down() -> None:
    logits = jnp.array([[0.0, 1.0, 5.0], [0.0, 1.0, 5.0]])
    ball = jnp.array([[True, True, False], [False, True, False]])
    chance = jax.nn.softmax(relations.all_solved(logits, ball))[:, 1]
    one = 1 / (1 + np.exp(-1.0))
    np.testing.assert_allclose(chance, [0.5 * one, one], rtol=1e-5)


def test_far_chances_stay_finite() -> None:
    found = relations.all_solved(jnp.array([[100.0], [-100.0]]), jnp.ones((2, 1), bool))
    assert found.shape == (2, CLASSES)
    assert np.isfinite(found).all()


def test_a_time_between_two_removals_and_their_order() -> None:
    plans = inputs.Plans(jnp.array([[1.0, 3.0, 0.0]]), jnp.array([[1.0, 1.0, 0.0]]))
    found = relations.order(plans)
    assert found.shape == (1, 3, 3, len(relations.SPANS) + 2)
    assert found[0, 0, 1, 1] == pytest.approx(np.tanh(2.0))
    assert found[0, 1, 0, -2] == -1  # the first goes before the second
    assert found[0, 0, 2, -2] == 1  # and both before one that stays
    assert found[0, :, :, -1].tolist() == [[1, 1, 0], [1, 1, 0], [0, 0, 0]]


@pytest.mark.slow
def test_nearest_points_of_bars() -> None:
    rows = np.zeros((1, 2, 9), np.float32)
    rows[0, 0, :5] = [0.5, 0.5, 0.5, 0.5, 1 / 30]  # a ball of 20 px
    rows[0, 1, :5] = [0.2, 0.55, 0.8, 0.55, 1 / 60]  # a bar under it, 30 px lower: they touch
    found = relations.near_features(jnp.asarray(rows))[0, 0, 1]
    np.testing.assert_allclose(found, [0, 0.15, 1, 1], atol=1e-4)


def test_mirrored_twice_is_the_same() -> None:
    rows = jnp.asarray(inputs.scene_rows(made_up(1, 0).scenes))
    which = jnp.array([True, False, True])
    once = mirror_rows(rows, which)
    assert (once[1] == rows[1]).all()
    assert once[0, 0, 0] == pytest.approx(1 - rows[0, 0, 0])
    np.testing.assert_allclose(mirror_rows(once, which), rows, atol=1e-6)


def test_a_ranker_judges_plans_together_as_one_by_one_and_whatever_the_order_of_objects() -> None:
    plays, config = made_up(4, 0), dataclasses.replace(settings("ranker"), width=16, rounds=1)
    scenes, seen = inputs.scene_inputs(plays.scenes, config), inputs.examples(plays, config)
    net, rows = network(config), jnp.asarray(scenes.rows)
    each = (rows[plays.game], seen.plans, scenes, plays.game)
    params, apply = jax.jit(net.init)(jax.random.key(0), *each), jax.jit(net.apply)
    one_by_one = apply(params, *each)
    assert one_by_one.shape == (12, CLASSES)
    assert np.std(np.asarray(one_by_one)) > 0
    grouped = inputs.Plans(*(np.asarray(part).reshape(3, 4, 12) for part in seen.plans))
    together = apply(params, rows, grouped, scenes, np.arange(3))
    np.testing.assert_allclose(np.asarray(together).reshape(12, CLASSES), one_by_one, rtol=1e-4, atol=1e-5)
    order = np.random.default_rng(0).permutation(12)
    moved = inputs.Plans(*(part[..., order] for part in grouped))
    np.testing.assert_allclose(
        apply(params, rows[:, order], moved, scenes, np.arange(3)), together, rtol=1e-3, atol=1e-4
    )


def test_bumps_tell_early_times_apart_and_a_block_that_stays_has_none() -> None:
    plans = inputs.Plans(jnp.array([[0.1, 0.2, 14.0, 14.1, 0.0]]), jnp.array([[1.0, 1.0, 1.0, 1.0, 0.0]]))
    found = np.asarray(ranker.bumps(plans))[0]
    assert found.dtype == np.float32
    assert np.abs(found[0] - found[1]).max() > np.abs(found[2] - found[3]).max() > 0.01
    assert not found[4].any()
    assert (found[:4, 0] == 1).all()
