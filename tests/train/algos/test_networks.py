"""Networks: shapes, the start at the head's prior, and objects that do not care for their row."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.envs.in_advance import observation_table
from iphyre_jax.scenes import SceneBuilder, load_scene
from iphyre_jax.train.algos.actor_critic import ActorCritic
from iphyre_jax.train.algos.networks import MLP, ObjectNetwork, _slot_objects
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.observations import parts, slot_mask, start_observations
from iphyre_jax.train.settings.run import TrainConfig, preset

OBS = jnp.asarray(observation_table(("hole", "multi_ball_spring")))


@pytest.mark.parametrize("shape", [(6, 3), (7,), ()])
def test_outputs_have_the_shape_asked_for(shape: tuple[int, ...]) -> None:
    for network in (MLP((16,), "relu", shape, 1.0), ObjectNetwork((16, 8), shape, 1.0)):
        params = jax.eval_shape(network.init, jax.random.key(0), OBS)
        assert jax.eval_shape(network.apply, params, OBS).shape == (2, *shape)


def test_a_dueling_network_parts_value_from_deviations() -> None:
    network = MLP((16,), "relu", (7,), 1.0, dueling=True)
    params = jax.jit(network.init)(jax.random.key(0), OBS)
    outputs = network.apply(params, OBS)
    layers = jax.tree.map(np.asarray, params["params"])
    hidden = np.maximum(np.asarray(OBS) @ layers["Dense_0"]["kernel"] + layers["Dense_0"]["bias"], 0)
    np.testing.assert_allclose(outputs.mean(axis=-1), (hidden @ layers["Dense_2"]["kernel"])[:, 0], atol=1e-5)


def test_a_centred_network_takes_away_what_it_was_initialised_with() -> None:
    given = {"hidden_sizes": (16,), "activation": "relu", "shape": (3,), "scale": 1.0}
    plain, centered = MLP(**given), MLP(**given, center_obs=True)  # type: ignore[arg-type]
    params = centered.init(jax.random.key(0), OBS)
    layers = {"params": {name: value for name, value in params["params"].items() if name != "centre"}}
    other = OBS[:1] + 0.1
    expected = plain.apply(layers, 2.0 * (other - OBS.mean(axis=0, keepdims=True)))
    np.testing.assert_allclose(centered.apply(params, other), expected, atol=1e-5)
    change = jax.grad(lambda given: centered.apply(given, other).sum())(params)  # type: ignore[attr-defined]
    assert not np.asarray(change["params"]["centre"]).any()  # it stays what it is


def shuffled(obs: jax.Array) -> jax.Array:
    """The same objects in other rows; the candidates, and so the slots, as they were."""
    taken = parts(obs)
    rows = taken.rows[:, np.random.default_rng(1).permutation(12)]
    return jnp.concatenate([rows.reshape(len(obs), -1), taken.candidates.reshape(len(obs), -1)], axis=1)


@pytest.mark.slow
def test_objects_do_not_care_for_their_row() -> None:
    network = ObjectNetwork((16, 16), (6, 5), 1.0)
    params, apply = jax.jit(network.init)(jax.random.key(0), OBS), jax.jit(network.apply)
    there = np.asarray(slot_mask(OBS))
    one, other = apply(params, OBS), apply(params, shuffled(OBS))
    np.testing.assert_allclose(one, other, atol=1e-4)
    assert np.abs(np.asarray(one)[there]).max() > 0.01
    assert len(np.unique(np.asarray(one)[0][there[0]].round(4), axis=0)) == there[0].sum()  # each slot its own


def test_blocks_at_the_edge_of_the_picture_are_seen() -> None:
    """Ends and centres are clipped: a block may lie half outside, or around a corner."""
    builder = SceneBuilder("edges")
    for ends in ((520, 330, 700, 330), (-40, -20, 20, 20), (100, 580, 200, 640), (300, 300, 400, 300)):
        builder.block(ends[:2], ends[2:], eliminable=True)
    builder.ball((300, 100))
    obs = start_observations("in-advance", "official", [builder.build()])
    np.testing.assert_array_equal(slot_mask(obs)[0], [True] * 4 + [False] * 2)
    found = parts(obs)
    np.testing.assert_array_equal(_slot_objects(found.rows, found.candidates)[0, :, :6], np.eye(6) * slot_mask(obs))


def test_a_block_between_the_ends_of_another_is_no_other() -> None:
    builder = SceneBuilder("crossing")
    for ends in ((0, 100, 300, 300), (20, 200, 80, 200)):
        builder.block(ends[:2], ends[2:], eliminable=True)
    builder.ball((400, 100))
    found = parts(start_observations("in-advance", "official", [builder.build()]))
    wanted = np.zeros((6, 12))
    wanted[0, 0] = wanted[1, 1] = 1
    np.testing.assert_array_equal(_slot_objects(found.rows, found.candidates)[0], wanted)
    wanted[1, 1] = 0
    np.testing.assert_array_equal(_slot_objects(found.rows.at[:, 1].set(0), found.candidates)[0], wanted)


@pytest.mark.slow
def test_the_first_policy_is_the_prior_for_every_scene() -> None:
    config = TrainConfig(hidden_sizes=(32,))
    for network in ("mlp", "objects"):
        chosen = dataclasses.replace(config, network=network)  # type: ignore[arg-type]
        agent = algorithm(chosen)
        assert isinstance(agent, ActorCritic)
        params = jax.jit(agent.init)(jax.random.key(0), OBS[:1]).params
        outputs = jax.jit(agent.policy_network.apply)(params["policy"], OBS)
        assert float(jnp.abs(jnp.asarray(outputs)).max()) < 0.1


def test_masks_are_found_in_every_kind_of_observation() -> None:
    for strategy in ("in-advance", "combined", "on-the-fly"):
        for observation in ("official", "motion"):
            obs = start_observations(strategy, observation, ["hole", "support"])  # type: ignore[arg-type]
            blocks = [len(load_scene(game).eliminable_blocks) for game in ("hole", "support")]
            np.testing.assert_array_equal(slot_mask(obs).sum(axis=1), blocks)
    assert preset("ppo", "on-the-fly").observation == "motion"
